//! The commands from outside: outputs, exit codes, nothing half-written.

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_verge-detector")).args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// `count` grey pictures, the first `nights` of them dark.
fn pictures(folder: &Path, count: usize, nights: usize) {
    fs::create_dir_all(folder).unwrap();
    for i in 0..count {
        let value = if i < nights { 25 } else { 150 };
        image::RgbImage::from_pixel(12, 9, image::Rgb([value; 3]))
            .save(folder.join(format!("p{i:02}.png")))
            .unwrap();
    }
}

fn expect(output: &Output, code: i32, words: &[&str]) {
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{error}");
    for word in words {
        assert!(error.contains(word), "`{word}` is not in: {error}");
    }
}

#[test]
fn mix_balances_prints_and_lists() {
    let root = folder("mix");
    pictures(&root.join("a"), 30, 10);
    pictures(&root.join("b"), 40, 8);
    let (a, b) = (format!("a={}", text(&root.join("a"))), format!("b={}", text(&root.join("b"))));
    let out = root.join("out");
    let arguments = ["mix", "--set", &a, "--set", &b, "--seed", "7", "--out", text(&out)];
    let first = run(&arguments);
    assert!(first.status.success(), "{}", String::from_utf8_lossy(&first.stderr));
    let table = String::from_utf8(first.stdout).unwrap();
    // All 18 nights; days are 5/3 of them, 30, split 3 to 5 at most: 11.25 and 18.75 down to
    // whole pictures.
    assert!(table.contains("18 of 18") && table.contains("29 of 52"), "{table}");
    let list = fs::read_to_string(out.join("mix.txt")).unwrap();
    assert_eq!(list.lines().count(), 47);
    assert!(run(&arguments).status.success());
    assert_eq!(list, fs::read_to_string(out.join("mix.txt")).unwrap());
    let shares = fs::read_to_string(out.join("shares.txt")).unwrap();
    let sum: f64 =
        shares.lines().map(|l| l.rsplit_once(' ').unwrap().1.parse::<f64>().unwrap()).sum();
    assert!((sum - 1.0).abs() < 1e-5, "{shares}");
}

#[test]
fn mix_takes_scenarios_from_a_file() {
    let root = folder("scenario");
    pictures(&root.join("a"), 6, 0);
    let file = root.join("scenarios.txt");
    fs::write(&file, "# by hand\np00.png rain\na/p01.png rain\np02.png\train\n").unwrap();
    let set = format!("a={}", text(&root.join("a")));
    let out = root.join("out");
    let output =
        run(&["mix", "--set", &set, "--scenario", text(&file), "--seed", "1", "--out", text(&out)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rain = fs::read_to_string(out.join("a.rain.txt")).unwrap();
    assert_eq!(rain.lines().count(), 3);
}

#[test]
fn mix_says_what_is_wrong() {
    let root = folder("mix-errors");
    pictures(&root.join("a"), 4, 0);
    fs::create_dir_all(root.join("empty")).unwrap();
    let a = format!("a={}", text(&root.join("a")));
    let empty = format!("e={}", text(&root.join("empty")));
    let out = root.join("out");
    let common = ["--seed", "1", "--out", text(&out)];
    let with = |extra: &[&str]| run(&[&["mix"], extra, &common[..]].concat());
    expect(&with(&["--set", "nonsense"]), 64, &["NAME=DIR"]);
    expect(&with(&["--set", &a, "--beta", "2"]), 64, &["beta"]);
    expect(&run(&["mix"]), 64, &["--set"]);
    expect(&with(&["--set", "a=/no/such/place"]), 66, &["/no/such/place"]);
    expect(&with(&["--set", &a, "--set", &empty]), 65, &["data set e", "(5)"]);
    assert!(!out.exists());
    fs::write(&out, "a file where the folder should be").unwrap();
    expect(&with(&["--set", &a]), 73, &["cannot write"]);
}

/// A recording of two frames, a day one and a night one, with one vehicle each.
fn recording(root: &Path) {
    for (name, value) in [("d.png", 150), ("n.png", 20)] {
        image::RgbImage::from_pixel(64, 48, image::Rgb([value; 3])).save(root.join(name)).unwrap();
    }
    let line = |name: &str| {
        format!(
            "{{\"frame\":\"{name}\",\"vehicles\":[{{\"class\":\"car\",\"box\":[10,10,30,30]}}]}}\n"
        )
    };
    fs::write(root.join("truth.jsonl"), line("d.png") + &line("n.png")).unwrap();
}

#[test]
fn eval_scores_by_light_and_ignores_regions() {
    let root = folder("eval");
    recording(&root);
    let detections = root.join("found.jsonl");
    fs::write(
        &detections,
        "{\"frame\":\"d.png\",\"boxes\":[[10,10,30,30,0.9,\"car\"],[40,5,50,12,0.95,\"car\"]]}\n\
         {\"frame\":\"n.png\",\"boxes\":[]}\n",
    )
    .unwrap();
    let common = ["eval", "--truth", text(&root), "--detections", text(&detections), "--json"];
    let output = run(&common);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let plain: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plain["day"]["ap50"].as_f64(), Some(0.5));
    assert_eq!(plain["night"]["recall"].as_f64(), Some(0.0));
    let ignore = root.join("ignore.jsonl");
    fs::write(&ignore, "{\"frame\":\"d.png\",\"boxes\":[[32,0,64,20]]}\n").unwrap();
    let curves = root.join("curves.png");
    let extra = ["--ignore", text(&ignore), "--curves", text(&curves)];
    let output = run(&[&common[..], &extra].concat());
    let masked: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(masked["day"]["ap50"].as_f64().map(|v| v > 0.999), Some(true));
    assert_eq!(masked["all"]["vehicles"].as_u64(), Some(2));
    assert!(image::open(&curves).unwrap().width() > 300);
}

#[test]
fn eval_says_what_is_wrong() {
    let root = folder("eval-errors");
    recording(&root);
    let file = root.join("found.jsonl");
    let score = |content: &str| {
        fs::write(&file, content).unwrap();
        run(&["eval", "--truth", text(&root), "--detections", text(&file)])
    };
    expect(&score("{\"frame\":\"d.png\",\"boxes\":[]}\n"), 65, &["n.png", "1 of 2"]);
    expect(&score("{\"frame\":\"d.png\"}\n"), 65, &["line 1", "boxes"]);
    expect(&score("{\"frame\":\"d.png\",\"boxes\":[[9,9,1,1,0.5,\"car\"]]}"), 65, &["turned"]);
    let gone = root.join("gone.jsonl");
    expect(&run(&["eval", "--truth", text(&root), "--detections", text(&gone)]), 66, &["gone"]);
    let output = run(&["eval", "--truth", "/no/such", "--detections", text(&file)]);
    expect(&output, 66, &["/no/such"]);
}

#[test]
fn eval_reads_yolo_labels_beside_and_in_labels() {
    let root = folder("yolo");
    for part in ["images", "labels"] {
        fs::create_dir_all(root.join(part)).unwrap();
    }
    image::RgbImage::new(100, 50).save(root.join("images/a.png")).unwrap();
    fs::write(root.join("labels/a.txt"), "0 0.5 0.5 0.2 0.4\n\n").unwrap();
    image::RgbImage::new(100, 50).save(root.join("b.png")).unwrap();
    fs::write(root.join("b.txt"), "").unwrap();
    let file = root.join("found.jsonl");
    fs::write(
        &file,
        "{\"frame\":\"a.png\",\"boxes\":[[40,15,60,35,0.5,\"car\"]]}\n{\"frame\":\"b.png\",\"boxes\":[]}\n",
    )
    .unwrap();
    let output = run(&["eval", "--truth", text(&root), "--detections", text(&file), "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["all"]["frames"].as_u64(), Some(2));
    assert_eq!(found["all"]["ap50"].as_f64().map(|v| v > 0.999), Some(true));
    fs::write(root.join("b.txt"), "0 0.5 oops 1 1\n").unwrap();
    let output = run(&["eval", "--truth", text(&root), "--detections", text(&file)]);
    expect(&output, 65, &["b.txt line 1", "oops"]);
}
