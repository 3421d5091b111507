//! `verge check` on whole configurations: it opens what `verge run` opens.

mod common;
#[path = "common/fake_broker.rs"]
mod fake_broker;

use fake_broker::{FakeBroker, Manners};
use std::path::Path;
use std::process::Output;
use std::time::{Duration, Instant};

/// A configuration that is right, with these lines at its end.
fn configuration(folder: &Path, port: u16, more: &str) -> String {
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"checked\"\n[camera]\nid = \"curve\"\ninterval_s = 1\nwatch = false\n\
         source = \"{here}/{}\"\n[model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [10]\n[mqtt]\nport = {port}\n{more}",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE
    );
    let path = folder.join("verge.toml");
    std::fs::write(&path, text).expect("written");
    path.to_str().expect("UTF-8").to_owned()
}

fn check(configuration: &str) -> (Output, String) {
    let output = common::verge(&["check", "--config", configuration]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    (output, said)
}

#[test]
fn what_is_right_passes_and_leaves_nothing_behind() {
    let (broker, folder) = (FakeBroker::start(Manners::default()), common::folder());
    let more = format!("[metrics]\nfile = \"{}/verge.prom\"\n", folder.path().display());
    let (output, said) = check(&configuration(folder.path(), broker.port, &more));
    assert!(output.status.success(), "{said}{}", common::stderr(&output));
    assert!(said.contains("(lane 1 of 82 m one each 0.50 s, "), "{said}");
    for line in ["ok    spool:", "ok    metrics:", "ok    broker:", "MQTT 5", "as this user"] {
        assert!(said.contains(line), "{line} in {said}");
    }
    let left: Vec<_> = std::fs::read_dir(folder.path())
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name())
        .collect();
    assert_eq!(left, ["verge.toml"]);
    // An empty message on each density topic, and `presence` as it was: not there.
    let taken = broker.seen(|seen| seen.taken.clone());
    let last = taken.iter().rev().find(|(topic, _)| topic.ends_with("presence"));
    assert_eq!(last.map(|(_, payload)| payload.len()), Some(0), "{taken:?}");
    assert_eq!(broker.windows(), 0);
}

#[test]
fn what_run_could_not_write_or_send_fails() {
    let reason = Some(("density/", 0x87));
    let (broker, folder) =
        (FakeBroker::start(Manners { reason, ..Manners::default() }), common::folder());
    std::fs::write(folder.path().join("spool"), "in the way").expect("written");
    let more = "[metrics]\nfile = \"/no/such/folder/verge.prom\"\n";
    let (output, said) = check(&configuration(folder.path(), broker.port, more));
    assert_eq!(output.status.code(), Some(73), "{said}");
    for line in ["FAIL  spool:", "in its way", "FAIL  metrics:", "make its folder", "FAIL  broker:"]
    {
        assert!(said.contains(line), "{line} in {said}");
    }
    assert!(common::stderr(&output).contains("3 of"), "{}", common::stderr(&output));
}

/// A case in which `run` delivers no density, with what `check` says of it.
struct Case {
    /// As it stands in docs/reference/check.md.
    name: &'static str,
    /// Sent to each request of the camera.
    camera: Camera,
    broker: Manners,
    /// Where in the report it fails, and in which words.
    part: &'static str,
    words: &'static str,
}

/// Behaviour of a camera.
#[derive(Clone)]
enum Camera {
    /// These pictures, one after the other.
    Pictures(Vec<Vec<u8>>),
    /// The same answer each time.
    Answers(Vec<u8>),
    /// Nobody is there.
    Closed,
}

fn case(name: &'static str, camera: Camera, part: &'static str, words: &'static str) -> Case {
    Case { name, camera, broker: Manners::default(), part, words }
}

/// With `VERGE_LONG=1` `run` is tried too, which takes half a minute a case.
fn is_long() -> bool {
    std::env::var_os("VERGE_LONG").is_some()
}

fn denied(name: &'static str, broker: Manners, words: &'static str) -> Case {
    // The findings of `check` about a broker do not depend on the camera.
    let camera = if is_long() { Camera::Pictures(street_pictures()) } else { Camera::Closed };
    Case { name, camera, broker, part: "broker", words }
}

fn http(status: &str, kind: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

fn answer(status: &str, kind: &str, body: &[u8]) -> Camera {
    Camera::Answers(http(status, kind, body))
}

fn street_pictures() -> Vec<Vec<u8>> {
    let mut files: Vec<_> = std::fs::read_dir(common::STREET_FRAMES)
        .expect("it ships")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    files.iter().map(|file| std::fs::read(file).expect("it ships")).collect()
}

fn encoded(picture: &image::RgbImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90);
    encoder.encode_image(picture).expect("encoding to memory");
    bytes
}

/// A picture of the street by a camera that was turned to the left: the scene stands 64 px further to
/// the right.
fn turned(picture: &[u8]) -> Vec<u8> {
    let street = image::load_from_memory(picture).expect("a picture").into_rgb8();
    let moved = image::RgbImage::from_fn(street.width(), street.height(), |u, v| {
        *street.get_pixel((u + street.width() - 64) % street.width(), v)
    });
    encoded(&moved)
}

/// Serves a camera for as long as the test runs.
fn serve(camera: Camera) -> u16 {
    use std::io::{Read, Write};
    let listener = std::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = listener.local_addr().expect("bound").port();
    if matches!(camera, Camera::Closed) {
        return port;
    }
    let answers = match camera {
        Camera::Pictures(pictures) => {
            pictures.iter().map(|one| http("200 OK", "image/jpeg", one)).collect()
        }
        Camera::Answers(answer) => vec![answer],
        Camera::Closed => Vec::new(),
    };
    std::thread::spawn(move || {
        for (number, stream) in listener.incoming().map_while(Result::ok).enumerate() {
            let mut stream = stream;
            let _ = stream.read(&mut [0; 4096]);
            let _ = stream.write_all(&answers[number % answers.len()]);
        }
    });
    port
}

fn cases() -> Vec<Case> {
    let pictures = street_pictures();
    let jpeg = |bytes: &[u8]| answer("200 OK", "image/jpeg", bytes);
    let half = [&pictures[0][..pictures[0].len() / 2], b"\xff\xd9"].concat();
    let grey = |level| encoded(&image::RgbImage::from_pixel(320, 240, image::Rgb([level; 3])));
    let greys = (0..20).map(|step| grey(90 + 5 * step)).collect();
    let away = pictures.iter().map(|picture| turned(picture)).collect();
    let login =
        b"HTTP/1.1 401 Unauthorized\r\nWWW-Authenticate: Digest realm=\"c\", nonce=\"n\"\r\n\r\n";
    let v3 = || Manners { versions: vec![4], ..Manners::default() };
    let v5 = Manners::default;
    vec![
        case("nobody answers", Camera::Closed, "camera", "refuses the connection"),
        case("a web page", answer("200 OK", "text/html", b"<html>"), "camera", "login"),
        case("another path", answer("404 Not Found", "", b""), "camera", "check the path"),
        case("a login", Camera::Answers(login.to_vec()), "camera", "wants a login"),
        case("half a picture", jpeg(&half), "camera", "damaged"),
        case("another shape", jpeg(&common::jpeg(640, 360, 90)), "camera", "of its shape"),
        case("one colour", Camera::Pictures(greys), "measurement", "blank_picture"),
        case("a turned camera", Camera::Pictures(away), "measurement", "to the right"),
        denied("a wrong password", Manners { refuses: Some(5), ..v3() }, "refuses"),
        denied("a topic denied", Manners { reason: Some(("density/", 0x87)), ..v5() }, "allow"),
        denied("dropped in silence", Manners { drops: Some("density/"), ..v3() }, "throws it away"),
        denied("nobody subscribes", Manners { reason: Some(("density/", 0x10)), ..v5() }, "nobody"),
        denied("closed on a topic", Manners { closes_on: Some("density/"), ..v5() }, "closes"),
        denied("never acknowledged", Manners { ignores: Some("density/"), ..v5() }, "acknowledge"),
        denied(
            "packets too large",
            Manners { properties: vec![0x27, 0, 0, 4, 176], ..v5() },
            "1200",
        ),
        denied("too large, untold", Manners { closes_from: Some(1200), ..v3() }, "max_packet_size"),
        denied("no QoS 1", Manners { properties: vec![0x24, 0], ..v5() }, "allow QoS 1"),
    ]
}

/// Windows with a density that arrived.
fn densities(broker: &FakeBroker) -> usize {
    let number = |payload: &[u8]| {
        let text = String::from_utf8_lossy(payload);
        text.split("\"density_veh_km\":")
            .skip(1)
            .any(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
    };
    broker.seen(|seen| {
        seen.taken
            .iter()
            .filter(|(topic, payload)| topic.contains("density/") && number(payload))
            .count()
    })
}

#[test]
fn where_run_delivers_no_density_check_fails_and_says_why() {
    let cases = cases();
    for some in cases.chunks(5) {
        std::thread::scope(|scope| {
            for case in some {
                scope.spawn(|| try_case(case));
            }
        });
    }
}

fn try_case(case: &Case) {
    let (name, folder) = (case.name, common::folder());
    let broker = FakeBroker::start(case.broker.clone());
    let port = serve(case.camera.clone());
    let file = configuration(folder.path(), broker.port, "user = \"box7\"\n");
    let text = std::fs::read_to_string(&file).expect("just written");
    let lines = text.lines().filter(|line| !line.starts_with("watch")).map(|line| {
        let is_source = line.starts_with("source");
        let there = format!("source = \"http://127.0.0.1:{port}/\"\ntimeout_s = 3");
        if is_source { there } else { line.to_owned() }
    });
    std::fs::write(&file, lines.collect::<Vec<_>>().join("\n")).expect("written");
    let (output, said) = check(&file);
    assert!(!output.status.success(), "{name}: {said}");
    let failed = said.lines().find(|line| line.starts_with(&format!("FAIL  {}:", case.part)));
    assert!(failed.is_some_and(|line| line.contains(case.words)), "{name}: {said}");
    if !is_long() {
        return;
    }
    let mut running = std::process::Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config", &file])
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("it starts");
    std::thread::sleep(std::time::Duration::from_secs(30));
    running.kill().and_then(|()| running.wait()).expect("ours");
    assert_eq!(densities(&broker), 0, "{name}: {:?}", broker.seen(|seen| seen.came.clone()));
}

/// A spool that cannot be written is named with its reason and what to do, when `run` starts.
#[test]
fn run_says_why_the_spool_takes_nothing_and_what_to_do() {
    use std::io::{BufRead, BufReader};
    let folder = common::folder();
    std::fs::write(folder.path().join("way"), "in the way").expect("written");
    let more = "[spool]\nfolder = \"way/spool\"\n";
    let file = configuration(folder.path(), 1, more);
    let mut running = std::process::Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config", &file])
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("it starts");
    let log = BufReader::new(running.stderr.take().expect("piped"));
    let said = log.lines().map_while(Result::ok).find(|line| line.contains("ERROR"));
    running.kill().and_then(|()| running.wait()).expect("ours");
    let said = said.expect("an error");
    for words in
        ["way/spool", "a file is in its way", "name another place", "lost at the next restart"]
    {
        assert!(said.contains(words), "{words} in {said}");
    }
    assert!(!said.contains("os error"), "{said}");
}

/// The daemon's log while it runs with this configuration, from its folder, until `done`.
fn log_until(folder: &Path, done: impl Fn(&[String]) -> bool) -> Vec<String> {
    use std::io::{BufRead, BufReader};
    let mut running = std::process::Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config", "verge.toml"])
        .current_dir(folder)
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("it starts");
    let log = BufReader::new(running.stderr.take().expect("piped"));
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        log.lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
    });
    let (mut lines, begun) = (Vec::<String>::new(), Instant::now());
    while !done(&lines) && begun.elapsed() < Duration::from_secs(60) {
        lines.extend(receiver.recv_timeout(Duration::from_millis(100)));
    }
    running.kill().and_then(|()| running.wait()).expect("ours");
    assert!(done(&lines), "{lines:?}");
    lines
}

#[test]
fn a_metrics_file_without_a_folder_is_checked_and_written_beside_the_configuration() {
    let (broker, folder) = (FakeBroker::start(Manners::default()), common::folder());
    configuration(folder.path(), broker.port, "[metrics]\nfile = \"verge.prom\"\n");
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["check", "--config", "verge.toml"])
        .current_dir(folder.path())
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", common::stderr(&output));
    assert!(said.contains("ok    metrics: verge.prom: can be written"), "{said}");
    let file = folder.path().join("verge.prom");
    assert!(!file.exists(), "check leaves nothing behind");
    log_until(folder.path(), |_| file.exists());
    let text = std::fs::read_to_string(&file).expect("written");
    assert!(text.contains("verge_build_info{site=\"checked\""), "{text}");
}

#[test]
fn a_folder_whose_pictures_are_gone_is_said_once() {
    let folder = common::folder();
    let frames = folder.path().join("frames");
    std::fs::create_dir(&frames).expect("made");
    let pictures: Vec<_> = std::fs::read_dir(common::STREET_FRAMES)
        .expect("they ship")
        .map(|entry| entry.expect("an entry").path())
        .take(4)
        .collect();
    for picture in &pictures {
        let name = frames.join(picture.file_name().expect("a file"));
        // A link to nothing: the file is listed, and gone when it is to be read.
        std::os::unix::fs::symlink("gone", name).expect("a link");
    }
    configuration(folder.path(), 1, "");
    let path = folder.path().join("verge.toml");
    let text = std::fs::read_to_string(&path).expect("written");
    let here = std::env::current_dir().expect("a working directory");
    let shipped = format!("{}/{}", here.display(), common::STREET_FRAMES);
    std::fs::write(
        &path,
        text.replace(&shipped, "frames").replace("interval_s = 1", "interval_s = 0.2"),
    )
    .expect("written");
    let begun = Instant::now();
    let log = log_until(folder.path(), |_| begun.elapsed() > Duration::from_secs(8));
    let said: Vec<_> = log.iter().filter(|line| line.contains("no measurement")).collect();
    assert_eq!(said.len(), 1, "{log:#?}");
    assert!(said[0].contains("no such file"), "{said:?}");
}

/// The interval that `check` advises for a camera that is asked each second, s, and all that it says.
fn advised(port: u16) -> (Option<u32>, String) {
    let (broker, folder) = (FakeBroker::start(Manners::default()), common::folder());
    let file = configuration(folder.path(), broker.port, "");
    let text = std::fs::read_to_string(&file).expect("just written");
    let lines = text.lines().filter(|line| !line.starts_with("watch")).map(|line| {
        let there = format!("source = \"http://127.0.0.1:{port}/\"");
        if line.starts_with("source") { there } else { line.to_owned() }
    });
    std::fs::write(&file, lines.collect::<Vec<_>>().join("\n")).expect("written");
    let (_, said) = check(&file);
    let failed = said.lines().find(|line| line.starts_with("FAIL  measurement:"));
    let advised = failed.and_then(|line| line.split("set camera.interval_s = ").nth(1));
    (advised.and_then(|rest| rest.split(',').next()?.parse().ok()), said)
}

/// A camera that takes longer for a picture than it is asked: `run` would have too few of them.
#[test]
fn a_camera_that_answers_late_is_told_with_its_period() {
    use std::io::{Read, Write};
    let pictures = street_pictures();
    let listener = std::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = listener.local_addr().expect("bound").port();
    std::thread::spawn(move || {
        for (number, mut stream) in listener.incoming().map_while(Result::ok).enumerate() {
            let _ = stream.read(&mut [0; 4096]);
            std::thread::sleep(std::time::Duration::from_millis(2600));
            let picture = &pictures[number % pictures.len()];
            let _ = stream.write_all(&http("200 OK", "image/jpeg", picture));
        }
    });
    let (period, said) = advised(port);
    assert!(period.is_some_and(|s| (3..=5).contains(&s)), "{said}");
}

/// A camera with a new picture each 20 s that is asked each second: not frozen, but slow, with what to
/// set; also where the picture is compressed again each time.
#[test]
fn a_slow_camera_is_told_with_its_period() {
    use std::io::{Read, Write};
    let pictures = street_pictures();
    let begun = std::time::Instant::now();
    let listener = std::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = listener.local_addr().expect("bound").port();
    std::thread::spawn(move || {
        for (number, mut stream) in listener.incoming().map_while(Result::ok).enumerate() {
            let _ = stream.read(&mut [0; 4096]);
            let picture = &pictures[(begun.elapsed().as_secs() / 20) as usize % pictures.len()];
            // A comment of its own: other bytes, the same picture.
            let comment = format!("\u{2}{:04}", number % 10_000);
            let own =
                [&picture[..2], b"\xff\xfe\0\x07", comment.as_bytes(), &picture[2..]].concat();
            let _ = stream.write_all(&http("200 OK", "image/jpeg", &own));
        }
    });
    let (period, said) = advised(port);
    // A loaded machine asks less often, and sees a change late.
    assert!(period.is_some_and(|s| (18..=40).contains(&s)) && !said.contains("frozen"), "{said}");
}

#[test]
fn who_turns_the_camera_is_told_how_far_and_which_way() {
    let (folder, pictures) = (common::folder(), street_pictures());
    let there = folder.path().join("frames");
    std::fs::create_dir(&there).expect("made");
    // Turned away first, then in place.
    for (second, picture) in pictures.iter().take(13).enumerate() {
        let bytes = if second < 2 { turned(picture) } else { picture.clone() };
        std::fs::write(there.join(format!("20260105T0800{second:02}Z.jpg")), bytes)
            .expect("written");
    }
    let file = configuration(folder.path(), 1, "");
    let text = std::fs::read_to_string(&file).expect("just written");
    let text = text.replace("watch = false\n", "").replace("interval_s = 1", "interval_s = 0.1");
    let here = std::env::current_dir().expect("a working directory");
    let text = text.replace(
        &format!("{}/{}", here.display(), common::STREET_FRAMES),
        there.to_str().expect("UTF-8"),
    );
    std::fs::write(&file, text).expect("written");
    let output = common::verge(&["check", "--aim", "--config", &file]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", common::stderr(&output));
    let away = "The scene stands 64 px to the right and 0 px down: turn the camera to the right";
    assert!(said.contains(away), "{said}");
    assert!(said.contains(": in place") && said.ends_with("where it was calibrated\n"), "{said}");
}

#[test]
fn pictures_are_written_as_png_and_a_table_needs_its_frames() {
    for (args, expected) in [
        (&["check", "--config", "verge.toml", "--overlay", "now.jpg"][..], "ends in .png"),
        (&["bench", "--table", common::STREET_TABLE], "--frames"),
    ] {
        let output = common::verge(args);
        let said = common::stderr(&output);
        assert!(output.status.code() == Some(64) && said.contains(expected), "{said}");
    }
}
