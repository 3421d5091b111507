//! Measures the scene's reference (see docs/health.md).
use mvcalib::scene_reference::{Mean, eye, picture, pictures, reference as reference_of};
use std::path::PathBuf;
use street::recording::Recorder;
use street::scene::Scene;
use verge::scene::{Pose, Sighting, search};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments[0].as_str() {
        "frames" => frames(&arguments[1], arguments[2].parse().unwrap(), &arguments[3..]),
        "looks" => looks(&arguments[1], arguments[2].parse().unwrap()),
        "others" => others(&arguments[1]),
        "street" => street_probe(&arguments[1], arguments[2].parse().unwrap(), &arguments[3..]),
        _ => panic!(),
    }
}

fn say(name: &str, s: &Sighting) {
    println!(
        "{name:<44} d {:+6.2} {:+6.2} turn {:+5.2} deg zoom {:.3}  Z {:6.2} support {:.2} agree {:.3}",
        s.pose.dx,
        s.pose.dy,
        s.pose.turn.to_degrees(),
        s.pose.zoom,
        s.significance,
        s.support,
        s.agreement
    );
}

/// frames LIST N more...: reference of the first N pictures of the list file, all are sought.
fn frames(dir: &str, n: usize, more: &[String]) {
    let files = if more.is_empty() {
        pictures(dir.as_ref()).unwrap()
    } else {
        more.iter().map(|m| PathBuf::from(dir).join(m)).collect()
    };
    let (_, reference) = reference_of(&files[..n], &[]).unwrap();
    println!("{} fine, {} coarse points", reference.fine.len(), reference.coarse.len());
    let mut map = vec![".".to_string(); 40 * 30];
    for p in &reference.fine {
        map[p.y as usize / 8 * 40 + p.x as usize / 8] = "#".into();
    }
    for row in map.chunks(40) {
        println!("{}", row.concat());
    }
    for file in &files {
        let (rgb, w, h) = picture(file).unwrap();
        let mut eye = eye(w, h);
        eye.look(&rgb);
        let begun = std::time::Instant::now();
        let seen = search(&reference, &eye);
        let ms = begun.elapsed().as_secs_f64() * 1e3;
        say(&format!("{} {ms:.1} ms", file.file_name().unwrap().to_string_lossy()), &seen);
    }
}

/// street SCENE N set...: reference of 8 frames by day, N frames with the changes are sought.
fn street_probe(path: &str, n: usize, set: &[String]) {
    let base = Scene::read(path.as_ref(), &["interval_s=10".into()]).unwrap();
    let mut recorder = Recorder::new(&base, 99).unwrap();
    let mut eye = eye(base.camera.width, base.camera.height);
    let mut mean = Mean::new(eye.grid());
    for _ in 0..8 {
        let f = recorder.next_frame();
        eye.look(&f.picture.data);
        mean.add(&eye, Pose::SAME);
    }
    let reference = mean.reference().unwrap();
    println!("{} fine, {} coarse points", reference.fine.len(), reference.coarse.len());
    let mut changes = vec!["interval_s=10".to_string()];
    changes.extend(set.iter().cloned());
    let scene = Scene::read(path.as_ref(), &changes).unwrap();
    let mut recorder = Recorder::new(&scene, 99).unwrap();
    for i in 0..n {
        let f = recorder.next_frame();
        let jpeg = f.picture.jpeg(scene.imaging.jpeg_quality, "f").unwrap();
        let rgb = image::load_from_memory(&jpeg).unwrap().into_rgb8().into_raw();
        eye.look(&rgb);
        let begun = std::time::Instant::now();
        let seen = search(&reference, &eye);
        let ms = begun.elapsed().as_secs_f64() * 1e3;
        let view = street::faults::View::at(&scene, 99, i as f64 * 10.0);
        let a = view.sway.scaled_axis();
        let f = base.camera.focal_px;
        // A turn about the camera's own axes moves the middle's image by f times it.
        let (tx, ty) = (f * a.y, -f * a.x);
        say(
            &format!(
                "{i} {ms:.1} ms true {tx:+.2} {ty:+.2} err {:+.2} {:+.2}",
                f64::from(seen.pose.dx) - tx,
                f64::from(seen.pose.dy) - ty
            ),
            &seen,
        );
    }
}

/// others DIR: the first picture of each camera (name up to the dash) against all others'.
fn others(dir: &str) {
    let mut files: Vec<PathBuf> = Vec::new();
    let camera = |p: &PathBuf| p.file_name().unwrap().to_string_lossy()[..4].to_string();
    let mut refs = Vec::new();
    for file in pictures(dir.as_ref()).unwrap() {
        let new = files.iter().filter(|f| camera(f) == camera(&file)).count();
        if new < 3 {
            files.push(file.clone());
        }
        if new == 0 {
            if let Ok(r) = reference_of(&[file.clone()], &[]) {
                refs.push((camera(&file), r.0, r.1));
            }
        }
    }
    let mut z = Vec::new();
    for file in &files {
        let (rgb, w, h) = picture(file).unwrap();
        let mut eye = eye(w, h);
        eye.look(&rgb);
        for (name, grid, reference) in &refs {
            if *name == camera(file) || *grid != eye.grid() {
                continue;
            }
            z.push((search(reference, &eye), name.clone(), file.clone()));
        }
    }
    z.sort_by(|a, b| b.0.significance.total_cmp(&a.0.significance));
    println!("{} pairs of different cameras", z.len());
    for (s, name, file) in z.iter().take(25) {
        say(&format!("{name} in {}", file.file_name().unwrap().to_string_lossy()), s);
    }
    for q in [50, 90, 99] {
        println!("{q} % {:.2}", z[z.len() * (100 - q) / 100].0.significance);
    }
}
/// looks DIR STEP: picture statistics of every STEPth picture, as it is and blurred.
fn looks(dir: &str, step: usize) {
    use verge::picture::{Look, changed_blocks};
    let mut before: Vec<u8> = vec![];
    for file in pictures(dir.as_ref()).unwrap().iter().step_by(step) {
        let (rgb, w, h) = picture(file).unwrap();
        let mut eye = eye(w, h);
        eye.look(&rgb);
        let g = eye.grid();
        let look = Look::at(eye.luma(), g.width);
        let changed = if before.len() == eye.luma().len() {
            changed_blocks(&before, eye.luma(), g.width)
        } else {
            99
        };
        before = eye.luma().to_vec();
        let image = image::RgbImage::from_raw(w, h, rgb).unwrap();
        let mut s = [0.0; 4];
        for (k, sigma) in [1.0, 2.0, 3.0, 5.0].into_iter().enumerate() {
            eye.look(image::imageops::blur(&image, sigma * w as f32 / 320.0).as_raw());
            s[k] = Look::at(eye.luma(), g.width).sharpness;
        }
        println!(
            "{:<30} mean {:5.1} span {:3} contrast {:3} bright {:.3} sharp {:.3} blurred {:.3?} changed {changed} {:?}",
            file.file_name().unwrap().to_string_lossy(),
            look.mean,
            look.span,
            look.contrast,
            look.bright,
            look.sharpness,
            s,
            look.flaw()
        );
    }
}
