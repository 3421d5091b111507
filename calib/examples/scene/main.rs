//! Measures how well a moved camera is noticed and a shaking one borne
//! (docs/explanation/health.md has the results and the command of each).
//!
//! ```text
//! scene moves SCENE [CASES [LIGHT]]  moves of 2 % or 2 degrees, by day, at night, in rain
//! scene day [FROM HOURS]   a day, or hours of it, with traffic, changing light, 2 px of shake
//! scene density            density with and without shake, and with it uncorrected
//! scene cameras DIR        pictures NAME-*.jpg of several fixed cameras, each against all
//! scene frames DIR [NAME]  one camera's pictures against the reference made of them
//! ```

mod cameras;
mod day;
mod density;
mod moves;

use mvcalib::road::scene_reference::{HeapEye, eye, pictures, reference};
use street::recording::Recorder;
use street::scene::Scene;
use verge::scene::Reference;

/// Time between frames, s.
const INTERVAL_S: f64 = 10.0;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |at, default| arguments.get(at).map_or(default, |n: &String| n.parse().expect("a number"));
    match arguments.first().map(String::as_str) {
        Some("moves") => {
            moves::moves(&arguments[1], number(2, 51), arguments.get(3).map(String::as_str));
        }
        Some("day") => day::day(number(1, 0), number(2, 24)),
        Some("density") => density::density(),
        Some("cameras") => cameras::cameras(arguments[1].as_ref()),
        Some("frames") => {
            cameras::frames(arguments[1].as_ref(), arguments.get(2).map(String::as_str))
        }
        _ => eprintln!("scene moves|day|density|cameras|frames"),
    }
}

fn scene(name: &str, changes: &[&str]) -> Scene {
    let path = format!("street/scenes/{name}.toml");
    let changes: Vec<String> = changes.iter().map(|c| (*c).to_owned()).collect();
    Scene::read(path.as_ref(), &changes).expect("a scene that ships")
}

/// The recording's next picture as a camera sends it: after JPEG.
fn next(recorder: &mut Recorder) -> Vec<u8> {
    let frame = recorder.next_frame();
    let quality = recorder.street().scene().imaging.jpeg_quality;
    let jpeg = frame.picture.jpeg(quality, "frame").expect("encoding to memory");
    image::load_from_memory(&jpeg).expect("a picture").into_rgb8().into_raw()
}

/// The reference as `mvcalib table --reference` makes it, of eight frames of a calm day.
fn reference_of(name: &str, seed: u64) -> Reference {
    let calm = scene(name, &["interval_s=20"]);
    let mut recorder = Recorder::new(&calm, seed).expect("a street");
    let folder = std::env::temp_dir().join(format!("verge-scene-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    let size = (calm.camera.width, calm.camera.height);
    for number in 0..8 {
        let rgb = next(&mut recorder);
        let image = image::RgbImage::from_raw(size.0, size.1, rgb).expect("a whole picture");
        image.save(folder.join(format!("{number}.png"))).expect("writing a frame");
    }
    let made = reference(&pictures(&folder).expect("frames"), &[]).expect("a clear scene").1;
    std::fs::remove_dir_all(&folder).expect("removing the frames");
    made
}

fn eye_of(scene: &Scene) -> HeapEye {
    eye(scene.camera.width, scene.camera.height)
}
