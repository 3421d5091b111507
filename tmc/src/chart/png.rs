//! A drawing as a PNG file: its SVG, rendered by resvg with the letters of DejaVu Sans.

use super::Drawing;
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
    picture.encode_png().expect("encoding to memory")
}
