//! A drawing as a PNG file: its SVG, rendered by resvg with the letters of DejaVu Sans.
//!
//! A report of a city has thousands of them, and compressing took longer than drawing: the quick method
//! of `png` makes files a little larger.

use super::Drawing;
use png::{BitDepth, ColorType, Compression, Encoder, EncodingError};
use resvg::tiny_skia::{Color, Pixmap, Transform};
use resvg::usvg::fontdb::{Database, Source};
use resvg::usvg::{Options, Tree};
use std::sync::{Arc, LazyLock};

static FONTS: LazyLock<Arc<Database>> = LazyLock::new(|| {
    let mut fonts = Database::new();
    fonts.load_font_source(Source::Binary(Arc::new(dejavu::sans::regular())));
    fonts.set_sans_serif_family("DejaVu Sans");
    Arc::new(fonts)
});

pub(super) fn png(drawing: &Drawing) -> Vec<u8> {
    let options = Options { fontdb: Arc::clone(&FONTS), ..Options::default() };
    let tree = Tree::from_str(&drawing.svg(), &options).expect("a drawing is SVG");
    let mut picture = Pixmap::new(drawing.width.max(1), drawing.height.max(1))
        .expect("drawings have the sizes of pictures");
    picture.fill(Color::WHITE);
    resvg::render(&tree, Transform::identity(), &mut picture.as_mut());
    encoded(&picture).expect("encoding to memory")
}

/// Without transparency, which white ground leaves none of.
fn encoded(picture: &Pixmap) -> Result<Vec<u8>, EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, picture.width(), picture.height());
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(Compression::Fast);
    let mut writer = encoder.write_header()?;
    let colours = picture.pixels().iter();
    let colours: Vec<u8> =
        colours.flat_map(|pixel| [pixel.red(), pixel.green(), pixel.blue()]).collect();
    writer.write_image_data(&colours)?;
    writer.finish()?;
    Ok(bytes)
}
