//! The desk over HTTP: who is refused, what never leaves the folder, and that what used to give
//! a silently wrong number is refused. The page itself: `tests/desk_browser`.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// The program on pictures of the simulated street, with a site in a folder of its own.
struct Desk {
    child: Child,
    port: u16,
    token: String,
    site: tempfile::TempDir,
}

fn street() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/freeway")
}

impl Desk {
    fn open(frames: &Path) -> Self {
        Self::again(frames, tempfile::tempdir().unwrap())
    }

    fn again(frames: &Path, site: tempfile::TempDir) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_mvcalib"))
            .arg("desk")
            .arg(frames)
            .arg("--site")
            .arg(site.path().join("site"))
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let rest = line.trim().strip_prefix("http://127.0.0.1:").expect("an address of loopback");
        let (port, token) = rest.split_once('/').unwrap();
        let (port, token) = (port.parse().unwrap(), token.trim_end_matches('/').to_owned());
        Desk { child, port, token, site }
    }

    /// Sends a request as it is written and gives status, head and body.
    fn raw(&self, request: &str) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").expect("a head");
        let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, head, bytes[end + 4..].to_vec())
    }

    fn get_with(&self, path: &str, host: &str, more: &str) -> (u16, String, Vec<u8>) {
        self.raw(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n"))
    }

    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        let host = format!("127.0.0.1:{}", self.port);
        self.get_with(&format!("/{}/{path}", self.token), &host, "")
    }

    fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        let body = body.to_string();
        let (status, _, answer) = self.raw(&format!(
            "POST /{}/{path} HTTP/1.1\r\nHost: localhost:{}\r\nConnection: close\r\n\
             Origin: http://localhost:{}\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\n\r\n{body}",
            self.token,
            self.port,
            self.port,
            body.len()
        ));
        (status, serde_json::from_slice(&answer).unwrap_or(Value::Null))
    }

    fn look(&self, drawing: &Value) -> Value {
        let (status, look) = self.post("api/look/0", drawing);
        assert_eq!(status, 200, "{look}");
        look
    }

    /// What a save refuses, in its words; nothing is written.
    fn refused(&self, drawing: &Value) -> String {
        let (status, answer) = self.post("api/save/0", drawing);
        assert_eq!(status, 422, "{answer}");
        assert!(!self.site.path().join("site/lanes.lut").exists());
        answer["error"].as_str().unwrap().to_owned()
    }

    fn drawing(&self) -> Value {
        let (status, _, body) = self.get("api/site");
        assert_eq!(status, 200, "{}", String::from_utf8_lossy(&body));
        let site: Value = serde_json::from_slice(&body).unwrap();
        site["drawing"].clone()
    }

    /// A drawing of the street's known lanes with two true lengths.
    fn true_drawing(&self) -> Value {
        let mut drawing = self.drawing();
        let lanes = lanes();
        let (lane_1, lane_2) = (&lanes[0], &lanes[1]);
        drawing["site"] = json!("bridge 7");
        drawing["camera_id"] = json!("freeway");
        drawing["lane_width_m"] = json!(3.66);
        let length = |a: usize, b: usize| json!({"points": [lane_1[a], lane_1[b]], "metres": metres(a, b), "standard": null});
        drawing["lengths"] = json!([length(1, 3), length(9, 14), length(1, 14)]);
        let half = lane_1.len() / 2;
        let line = |id: u32, lane: &[[f64; 2]]| {
            let points: Vec<_> = [1, 4, 8, 13].iter().map(|k| lane[*k]).collect();
            json!({"id": id, "points": points})
        };
        let left =
            |lane: &[[f64; 2]]| -> Vec<[f64; 2]> { lane[half..].iter().rev().copied().collect() };
        let (left_1, left_2) = (left(lane_1), left(lane_2));
        drawing["lines"] = json!([line(1, lane_1), line(2, &left_1), line(3, &left_2)]);
        let lane = |n: u8, right: &[[f64; 2]], left: &[[f64; 2]]| {
            let polygon = [right[1], right[8], left[8], left[1]];
            json!({"number": n, "direction": "away", "widens": false, "polygon": polygon})
        };
        drawing["lanes"] = json!([lane(1, lane_1, &left_1), lane(2, &left_1, &left_2)]);
        drawing
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The outlines of the street's lanes.
fn lanes() -> Vec<Vec<[f64; 2]>> {
    let text = std::fs::read_to_string(street().join("lanes.json")).unwrap();
    let file: Value = serde_json::from_str(&text).unwrap();
    let shapes = file["shapes"].as_array().unwrap();
    shapes.iter().map(|s| serde_json::from_value(s["points"].clone()).unwrap()).collect()
}

/// True distance between two vertices of the first lane's right edge, m.
fn metres(a: usize, b: usize) -> f64 {
    use mvcalib::files::calibration::Calibration;
    let camera = Calibration::read(&street().join("calibration.json"), None).unwrap().camera();
    let lane = &lanes()[0];
    let at = |k: usize| camera.back_project(&lane[k].into(), 0.0).unwrap();
    (at(a) - at(b)).norm()
}

#[test]
fn only_this_page_under_a_loopback_name_with_the_token_is_answered() {
    let desk = Desk::open(&street());
    let (port, token) = (desk.port, &desk.token);
    let (own, path) = (format!("127.0.0.1:{port}"), format!("/{token}/"));
    let status = |path: &str, host: &str, more: &str| desk.get_with(path, host, more).0;
    assert_eq!(status(&path, &own, ""), 200);
    assert_eq!(status(&path, &format!("localhost:{port}"), ""), 200);
    // Through `ssh -L` the port is another one.
    assert_eq!(status(&path, "localhost:9999", ""), 200);
    for host in ["evil.example", "127.0.0.1.evil.example", "[::2]", ""] {
        assert_eq!(status(&path, host, ""), 403, "{host}");
    }
    for more in [
        "Origin: http://evil.example\r\n",
        "Origin: null\r\n",
        "Origin: http://127.0.0.1:1\r\n",
        "Sec-Fetch-Site: cross-site\r\n",
        "Sec-Fetch-Site: same-site\r\n",
    ] {
        assert_eq!(status(&path, &own, more), 403, "{more}");
    }
    let other = "0".repeat(token.len());
    for path in
        ["/", "/page/main.js", "/api/site", &format!("/{other}/"), &format!("/{other}/api/site")]
    {
        assert_eq!(status(path, &own, ""), 403, "{path}");
    }
    // What a form of another page can send is no JSON.
    let form = format!(
        "POST {path}api/save/0 HTTP/1.1\r\nHost: {own}\r\nConnection: close\r\n\
         Content-Type: text/plain\r\nContent-Length: 2\r\n\r\n{{}}"
    );
    assert_eq!(desk.raw(&form).0, 415);
    let (_, head, body) = desk.get("");
    assert!(head.contains("default-src 'none'") && head.contains("no-referrer"), "{head}");
    assert!(!String::from_utf8_lossy(&body).contains("://"), "the page names another place");
}

#[test]
fn the_page_is_whole_and_names_no_other_place() {
    let desk = Desk::open(&street());
    let mut waiting = vec!["main.js".to_owned(), "style.css".to_owned()];
    let mut seen = Vec::new();
    while let Some(name) = waiting.pop() {
        if seen.contains(&name) {
            continue;
        }
        let (status, head, body) = desk.get(&format!("page/{name}"));
        assert_eq!(status, 200, "{name}");
        assert!(head.contains("text/"), "{head}");
        let text = String::from_utf8(body).unwrap();
        assert!(!text.contains("https://"), "{name}");
        for part in text.split("\"./").skip(1) {
            waiting.push(part.split('"').next().unwrap().to_owned());
        }
        seen.push(name);
    }
    assert!(seen.len() >= 14, "{seen:?}");
}

#[test]
fn nothing_outside_the_folder_of_pictures_is_given() {
    let frames = tempfile::tempdir().unwrap();
    let outside = tempfile::tempdir().unwrap();
    std::fs::write(outside.path().join("secret.jpg"), b"secret").unwrap();
    let from = street().join("frames/20260105T153000.000Z.jpg");
    std::fs::copy(from, frames.path().join("a b.jpg")).unwrap();
    std::fs::write(frames.path().join("notes.txt"), b"private").unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(outside.path().join("secret.jpg"), frames.path().join("z.jpg"))
        .unwrap();
    let desk = Desk::open(frames.path());
    assert_eq!(desk.get("api/picture/a%20b.jpg").0, 200);
    let secret = outside.path().join("secret.jpg");
    let absolute = secret.to_str().unwrap().replace('/', "%2F");
    for name in [
        "notes.txt",
        "z.jpg",
        "../a%20b.jpg",
        "..%2F..%2Fetc%2Fpasswd",
        "%2e%2e%2fsecret.jpg",
        "%252e%252e/secret.jpg",
        "",
        "%00",
        absolute.as_str(),
    ] {
        for what in ["api/picture", "api/shift", "page"] {
            let status = desk.get(&format!("{what}/{name}")).0;
            assert!(status == 404, "{what}/{name}: {status}");
        }
    }
    assert_eq!(desk.get("page/../../Cargo.toml").0, 404);
}

#[test]
fn a_true_drawing_is_saved_whole_and_opens_again() {
    let desk = Desk::open(&street());
    let drawing = desk.true_drawing();
    let look = desk.look(&drawing);
    assert_eq!(look["camera"]["trust"], "ok", "{look}");
    assert!(look["lanes"].as_array().unwrap().iter().all(|l| l["problem"].is_null()), "{look}");
    // The street's camera: f 760 px, 12.5 m high, 13.5 degrees down.
    let camera = &look["camera"];
    let near = |key: &str, is: f64, by: f64| {
        let value = camera[key].as_f64().unwrap();
        assert!((value / is - 1.0).abs() < by, "{key} {value}, it is {is}");
    };
    near("f_px", 760.0, 0.05);
    near("height_m", 12.5, 0.05);
    near("tilt_deg", 13.5, 0.05);
    let strips = look["strips"].as_array().unwrap();
    assert_eq!(strips.len(), 2);
    for strip in strips {
        assert!((strip["width_m"][1].as_f64().unwrap() - 3.66).abs() < 0.15, "{strip}");
    }
    assert!(look["dots"].as_array().unwrap().len() > 100);
    let (status, saved) = desk.post("api/save/0", &drawing);
    assert_eq!(status, 200, "{saved}");
    let file = |name: &str| std::fs::read(desk.site.path().join("site").join(name)).unwrap();
    let table = file("lanes.lut");
    let table = verge::lane::LaneTable::parse(&table[..]).unwrap();
    assert_eq!(table.description().camera_id.as_str(), "freeway");
    assert_eq!(table.description().lanes.len(), 2);
    assert!(table.scene().unwrap().is_some(), "a reference of the scene");
    let toml = String::from_utf8(file("verge.toml")).unwrap();
    assert!(toml.contains("site = \"bridge 7\"") && toml.contains("interval_s = 4.0"), "{toml}");
    // Both ways stay open: labelme's lanes and lengths make the same table and camera.
    for (name, shapes) in [("lanes.json", 2), ("lengths.json", 3), ("lane_lines.json", 4)] {
        let labelme: Value = serde_json::from_slice(&file(name)).unwrap();
        assert_eq!(labelme["shapes"].as_array().unwrap().len(), shapes, "{name}");
    }
    let (status, other) = desk.post("api/save/0", &drawing);
    assert_eq!(status, 422, "{other}");
    assert!(other["error"].as_str().unwrap().contains("another window"), "{other}");
    let again = desk.post("api/save/1", &drawing);
    assert_eq!((again.0, file("lanes.lut") == table_bytes(&desk)), (200, true));
    assert_eq!(desk.drawing(), drawing, "a page that is loaded again goes on");
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    let reopened = Desk::again(&street(), site);
    assert_eq!(reopened.drawing(), drawing);
    // Without its lines a drawing leaves none behind.
    let mut bare = drawing.clone();
    bare["lines"] = json!([]);
    let (right, left) =
        (bare["lanes"][0]["polygon"][0].clone(), bare["lanes"][0]["polygon"][3].clone());
    let across = json!({"points": [right, left], "metres": 3.66, "standard": null});
    bare["lengths"].as_array_mut().unwrap().push(across);
    assert_eq!(reopened.post("api/save/0", &bare).0, 200);
    let left = |name: &str| reopened.site.path().join("site").join(name).exists();
    assert_eq!((left("lane_lines.json"), left("lengths.json")), (false, true));
}

#[test]
fn what_is_drawn_and_not_saved_outlives_the_program() {
    let desk = Desk::open(&street());
    let mut drawing = desk.true_drawing();
    desk.look(&drawing);
    drawing["camera_id"] = json!("another");
    desk.look(&drawing);
    assert_eq!(desk.drawing(), drawing, "a page that is loaded again goes on");
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    let again = Desk::again(&street(), site);
    assert_eq!(again.drawing(), drawing);
    assert_eq!(again.post("api/save/0", &drawing).0, 200);
    assert!(!again.site.path().join("site/draft.json").exists());
}

#[test]
fn a_draft_on_other_pictures_is_kept_and_said() {
    let desk = Desk::open(&street());
    let mut drawing = desk.true_drawing();
    desk.look(&drawing);
    drawing["camera_id"] = json!("another");
    desk.look(&drawing);
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    let draft = std::fs::read(site.path().join("site/draft.json")).unwrap();
    // Other pictures, and what was drawn on those before is not on them.
    let frames = tempfile::tempdir().unwrap();
    let pixel = |u: u32, v: u32| image::Rgb([(u / 3) as u8, (v / 2) as u8, 90]);
    image::RgbImage::from_fn(640, 480, pixel).save(frames.path().join("a.png")).unwrap();
    let other = Desk::again(frames.path(), site);
    let site_json = |desk: &Desk| -> Value {
        let (status, _, body) = desk.get("api/site");
        assert_eq!(status, 200, "{}", String::from_utf8_lossy(&body));
        serde_json::from_slice(&body).unwrap()
    };
    let answer = site_json(&other);
    let said = answer["aside"].as_str().expect("the page names it");
    assert!(said.contains("draft-1.json") && said.contains("other pictures"), "{said}");
    let mut drawing = answer["drawing"].clone();
    assert_ne!(drawing["camera_id"], "another");
    for id in ["one", "two"] {
        drawing["camera_id"] = json!(id);
        other.look(&drawing);
    }
    let kept = |name: &str| std::fs::read(other.site.path().join("site").join(name));
    assert_eq!(kept("draft-1.json").unwrap(), draft, "as it was");
    assert_ne!(kept("draft.json").unwrap(), draft, "the new one");
    assert_eq!(site_json(&other)["drawing"]["camera_id"], "two");
    // It stays until the drawing is dropped.
    assert!(site_json(&other)["aside"].is_string());
    assert_eq!(other.post("api/draft/drop", &json!({})).0, 200);
    assert!(site_json(&other)["aside"].is_null());
}

#[test]
fn a_draft_goes_on_where_pictures_were_added() {
    let frames = tempfile::tempdir().unwrap();
    let add = |names: std::ops::Range<usize>| {
        let mut all: Vec<_> = std::fs::read_dir(street().join("frames"))
            .unwrap()
            .map(|e| e.unwrap().path())
            .collect();
        all.sort();
        for path in &all[names] {
            std::fs::copy(path, frames.path().join(path.file_name().unwrap())).unwrap();
        }
    };
    add(0..5);
    let desk = Desk::open(frames.path());
    let mut drawing = desk.true_drawing();
    desk.look(&drawing);
    drawing["camera_id"] = json!("another");
    desk.look(&drawing);
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    add(5..20);
    let again = Desk::again(frames.path(), site);
    let (_, _, body) = again.get("api/site");
    let answer: Value = serde_json::from_slice(&body).unwrap();
    assert!(answer["aside"].is_null(), "{}", answer["aside"]);
    assert_ne!(answer["backdrop"], drawing["backdrop"], "it is another picture");
    drawing["backdrop"] = answer["backdrop"].clone();
    assert_eq!(answer["drawing"], drawing);
    // Those that are added while it runs, too.
    drawing["camera_id"] = json!("a third");
    again.look(&drawing);
    add(20..40);
    assert_eq!(again.post("api/collect/use", &json!({})).0, 200);
    let carried = again.drawing();
    assert_eq!(carried["camera_id"], "a third");
    assert_eq!(again.post("api/save/0", &carried).0, 200);
    let left = |name: &str| again.site.path().join("site").join(name).exists();
    assert_eq!((left("draft.json"), left("draft.png")), (false, false));
}

#[test]
fn a_configuration_that_nobody_changed_follows_the_desk() {
    let desk = Desk::open(&street());
    let mut drawing = desk.true_drawing();
    let config =
        |desk: &Desk| std::fs::read_to_string(desk.site.path().join("site/verge.toml")).unwrap();
    assert_eq!(desk.post("api/save/0", &drawing).0, 200);
    let first = config(&desk);
    assert!(first.contains("# The folder of pictures at the desk."), "{first}");
    drawing["source"] = json!("rtsp://cam/s");
    let (_, saved) = desk.post("api/save/1", &drawing);
    assert!(!saved["files"].to_string().contains("by hand"), "{saved}");
    let text = config(&desk);
    assert!(!text.contains("# The folder") && text.contains("\"rtsp://cam/s\""), "{text}");
    drawing["source"] = json!("");
    assert_eq!(desk.post("api/save/2", &drawing).0, 200);
    assert_eq!(config(&desk), first);
    // Other pictures of the same scene, a minute apart.
    let frames = tempfile::tempdir().unwrap();
    let mut all: Vec<_> =
        std::fs::read_dir(street().join("frames")).unwrap().map(|e| e.unwrap().path()).collect();
    all.sort();
    for (n, path) in all.iter().enumerate() {
        std::fs::copy(path, frames.path().join(format!("20260106T10{n:02}00Z.jpg"))).unwrap();
    }
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    let other = Desk::again(frames.path(), site);
    let (status, saved) = other.post("api/save/0", &other.drawing());
    assert_eq!(status, 200, "{saved}");
    assert!(!saved["files"].to_string().contains("by hand"), "{saved}");
    let text = config(&other);
    let source = frames.path().canonicalize().unwrap();
    assert!(
        text.contains(source.to_str().unwrap()) && text.contains("interval_s = 60.0"),
        "{text}"
    );
    // What a person wrote stays, whatever pictures are opened.
    let by_hand =
        first.replace("[60, 900]", "[300]").replace("interval_s = 4.0", "interval_s = 2.0");
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    std::fs::write(site.path().join("site/verge.toml"), &by_hand).unwrap();
    let other = Desk::again(frames.path(), site);
    assert_eq!(other.post("api/save/0", &other.drawing()).0, 200);
    let text = config(&other);
    assert!(text.contains("[300]") && text.contains("interval_s = 2.0"), "{text}");
}

#[test]
fn where_nothing_tells_what_the_desk_wrote_nothing_is_overwritten() {
    let desk = Desk::open(&street());
    let mut drawing = desk.true_drawing();
    drawing["source"] = json!("http://cam/snap.jpg");
    assert_eq!(desk.post("api/save/0", &drawing).0, 200);
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    let _ = std::fs::remove_file(site.path().join("site/verge.toml.saved"));
    let edit = |name: &str, changes: &[[&str; 2]]| {
        let path = site.path().join("site").join(name);
        let text = std::fs::read_to_string(&path).unwrap();
        let text = changes.iter().fold(text, |text, [from, to]| text.replace(from, to));
        std::fs::write(&path, &text).unwrap();
        text
    };
    // As an earlier version took it, which could not be written today.
    let secret = ["http://cam/snap.jpg", "http://cam/snap.jpg?pwd=s3cret"];
    edit("site.json", &[secret]);
    let hand = edit(
        "verge.toml",
        &[
            secret,
            ["lengths_s = [60, 900]", "lengths_s = [300]"],
            ["interval_s = 4.0", "interval_s = 2"],
        ],
    );
    let again = Desk::again(&street(), site);
    let mut drawing = again.drawing();
    drawing["source"] = json!("");
    let (status, saved) = again.post("api/save/0", &drawing);
    assert_eq!(status, 200, "{saved}");
    let file = again.site.path().join("site/verge.toml");
    assert_eq!(std::fs::read_to_string(file).unwrap(), hand);
    assert!(saved["files"].to_string().contains("what stood in it stays"), "{saved}");
}

#[test]
fn saving_keeps_an_audit_however_it_is_written_and_takes_a_stale_one_out() {
    let desk = Desk::open(&street());
    let drawing = desk.true_drawing();
    let file = |name: &str| desk.site.path().join("site").join(name);
    assert_eq!(desk.post("api/save/0", &drawing).0, 200);
    let plain = std::fs::read_to_string(file("verge.toml")).unwrap();
    let version = std::cell::Cell::new(1);
    let saved = |text: &str| {
        std::fs::write(file("verge.toml"), text).unwrap();
        let (status, answer) = desk.post(&format!("api/save/{}", version.get()), &drawing);
        assert_eq!(status, 200, "{answer}");
        version.set(version.get() + 1);
        std::fs::read_to_string(file("verge.toml")).unwrap()
    };
    let table = "[lane_table]\nfile = \"lanes.lut\"\n";
    let with = |audit: &str| plain.replace(table, &format!("{table}{audit}\n"));
    std::fs::write(file("audit.toml"), "x = 1\n").unwrap();
    for text in [
        with("audit = \"audit.toml\""),
        with("audit = \"audit.toml\" # counted 5 May"),
        with("audit  =  'audit.toml'"),
        with("audit = \"./audit.toml\""),
        with("audit = \"mine.toml\""),
        with("# audit = \"audit.toml\""),
        with("audit = \"audit.toml\"").replace('\n', "\r\n"),
        format!("{}\n{table}audit = \"audit.toml\"", plain.replace(table, "")),
    ] {
        assert_eq!(saved(&text), text);
    }
    std::fs::remove_file(file("audit.toml")).unwrap();
    let inline = "lane_table = { file = \"lanes.lut\", audit = \"audit.toml\" }\n";
    let inline = plain.replace(table, "").replace("\n[camera]", &format!("{inline}\n[camera]"));
    for text in [
        with("audit = \"audit.toml\" # counted 5 May"),
        with("audit  =  'audit.toml'"),
        with("audit = \"./audit.toml\""),
        inline,
    ] {
        let now = saved(&text);
        assert!(!now.contains("audit") && now.contains("lanes.lut"), "{now}");
    }
    // Required keys come back, and the answer names another table.
    let now = saved("");
    for line in ["site = \"bridge 7\"", "source = ", "file = \"lanes.lut\""] {
        assert!(now.contains(line), "{now}");
    }
    std::fs::write(file("verge.toml"), plain.replace("lanes.lut", "old.lut")).unwrap();
    let (_, answer) = desk.post(&format!("api/save/{}", version.get()), &drawing);
    assert!(answer["files"].to_string().contains("lane table old.lut"), "{answer}");
}

#[test]
fn saving_again_keeps_what_was_written_into_the_configuration() {
    let desk = Desk::open(&street());
    let mut drawing = desk.true_drawing();
    assert_eq!(desk.post("api/save/0", &drawing).0, 200);
    let file = desk.site.path().join("site/verge.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let source = text.lines().find(|line| line.starts_with("source = ")).unwrap();
    let by_hand = text
        .replace(
            source,
            "source = \"rtsp://cam/s\" # on the box\nuser = \"box\"\npassword_file = \"secret\"",
        )
        .replace("lengths_s = [60, 900]", "lengths_s = [300]")
        + "\n# The city's broker.\n[mqtt]\nhost = \"broker.example\"\n";
    std::fs::write(&file, &by_hand).unwrap();
    assert_eq!(desk.post("api/save/1", &drawing).0, 200);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), by_hand, "nothing was changed at the desk");
    // What is typed at the desk counts, and nothing else changes.
    drawing["source"] = json!("http://cam/a.jpg");
    drawing["camera_id"] = json!("north");
    let (status, saved) = desk.post("api/save/2", &drawing);
    assert_eq!(status, 200, "{saved}");
    assert!(saved["files"].to_string().contains("by hand"), "{saved}");
    let folder = "# The folder of pictures at the desk. On the box: the camera's address.\n";
    let now = by_hand
        .replace("rtsp://cam/s", "http://cam/a.jpg")
        .replace("\"freeway\"", "\"north\"")
        .replace(folder, "");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), now);
    // What cannot be read is not overwritten.
    std::fs::write(&file, "site = \n").unwrap();
    let (status, answer) = desk.post("api/save/3", &drawing);
    let said = answer["error"].as_str().unwrap_or_default();
    assert!(status == 422 && said.contains("verge.toml") && said.contains("line 1"), "{answer}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "site = \n");
}

#[test]
fn a_password_in_the_query_of_an_address_is_a_login() {
    let desk = Desk::open(&street());
    let mut drawing = desk.true_drawing();
    for source in [
        "http://cam/snap.jpg?user=a&pwd=s3cret",
        "http://cam/cgi?PassWord=s3cret",
        "rtsp://cam/s?x=1&passwd=s3cret",
        "http://cam/s;pass=s3cret?x=1",
        "http://cam/cgi?cmd=Snap&pass%77ord=s3cret",
        "http://cam/a.jpg#pwd=s3cret",
        "rtsp://cam/user=admin_password=s3cret_channel=1_stream=0.sdp",
    ] {
        drawing["source"] = json!(source);
        let said = desk.refused(&drawing);
        assert!(said.contains("user or a password") && !said.contains("s3cret"), "{said}");
    }
    drawing["source"] = json!("http://cam/snap.jpg?channel=1&compass=2");
    assert_eq!(desk.post("api/save/0", &drawing).0, 200);
}

#[test]
fn a_lane_over_two_lanes_is_not_its_own_judge() {
    let desk = Desk::open(&street());
    let mut drawing = desk.true_drawing();
    let (a, b) = (drawing["lanes"][0]["polygon"].clone(), drawing["lanes"][1]["polygon"].clone());
    let both = json!([{"number": 1, "direction": "away", "widens": false,
        "polygon": [a[0], a[1], b[2], b[3]]}]);
    // Without lane lines the drawn lane alone shows how wide the road is, and must not.
    (drawing["lines"], drawing["lanes"]) = (json!([]), both);
    assert!(desk.refused(&drawing).contains("across the road lengths are uncertain"));
    let across = json!({"points": [a[0], a[3]], "metres": 3.66, "standard": null});
    drawing["lengths"].as_array_mut().unwrap().push(across);
    let look = desk.look(&drawing);
    let f = look["camera"]["f_px"].as_f64().unwrap();
    assert!((f / 760.0 - 1.0).abs() < 0.1, "{look}");
    assert!(desk.refused(&drawing).contains("covers two lanes"));
}

fn table_bytes(desk: &Desk) -> Vec<u8> {
    std::fs::read(desk.site.path().join("site/lanes.lut")).unwrap()
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
    }
}

#[test]
fn what_gave_a_wrong_number_without_a_word_is_refused() {
    let desk = Desk::open(&street());
    let good = desk.true_drawing();
    let with = |change: &dyn Fn(&mut Value)| {
        let mut drawing = good.clone();
        change(&mut drawing);
        drawing
    };
    let both = with(&|d| {
        let (a, b) = (d["lanes"][0]["polygon"].clone(), d["lanes"][1]["polygon"].clone());
        d["lanes"] = json!([{"number": 1, "direction": "away", "widens": false,
            "polygon": [a[0], a[1], b[2], b[3]]}]);
    });
    let problem = desk.look(&both)["lanes"][0]["problem"].clone();
    assert!(problem.as_str().unwrap().contains("covers two lanes"), "{problem}");
    let no_way = with(&|d| d["lanes"][0]["direction"] = json!(""));
    let problem = desk.look(&no_way)["lanes"][0]["problem"].clone();
    assert!(problem.as_str().unwrap().contains("which way"), "{problem}");
    for (drawing, expected) in [
        (both, "covers two lanes"),
        (no_way, "no direction"),
        (with(&|d| d["lanes"][0]["direction"] = json!("towards")), "'towards' is not known"),
        (with(&|d| d["lanes"][1]["number"] = json!(1)), "drawn twice"),
        (with(&|d| d["lanes"][1]["polygon"] = d["lanes"][0]["polygon"].clone()), "overlaps lane"),
        (with(&|d| d["lanes"] = json!([])), "no lane"),
        (with(&|d| d["lengths"][0]["metres"] = json!(40.0)), "look at its points"),
        (with(&|d| d["camera_id"] = json!("")), "give the camera a name"),
        (with(&|d| d["backdrop"] = json!("00")), "the camera has moved"),
        (
            with(&|d| {
                d["lengths"] = json!([]);
                d["lines"] = json!([]);
                d["lanes"] = json!([]);
            }),
            "nothing to calibrate from",
        ),
    ] {
        let said = desk.refused(&drawing);
        assert!(said.contains(expected), "{said}");
    }
}

#[test]
fn a_moved_camera_carries_its_points_along_and_needs_a_look() {
    let desk = Desk::open(&street());
    let drawing = desk.true_drawing();
    assert_eq!(desk.post("api/save/0", &drawing).0, 200);
    // The same pictures, 6 px to the right and 4 px down.
    let frames = tempfile::tempdir().unwrap();
    let mut names: Vec<PathBuf> =
        std::fs::read_dir(street().join("frames")).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    for path in names.iter().step_by(5) {
        let image = image::open(path).unwrap().to_rgb8();
        let moved = image::RgbImage::from_fn(image.width(), image.height(), |u, v| {
            *image.get_pixel(u.saturating_sub(6), v.saturating_sub(4))
        });
        moved.save(frames.path().join(path.file_name().unwrap()).with_extension("png")).unwrap();
    }
    let site = tempfile::tempdir().unwrap();
    copy(&desk.site.path().join("site"), &site.path().join("site"));
    std::fs::remove_file(site.path().join("site/lanes.lut")).unwrap();
    let moved = Desk::again(frames.path(), site);
    let (_, _, body) = moved.get("api/site");
    let answer: Value = serde_json::from_slice(&body).unwrap();
    let by = |k: usize| answer["moved"]["by"][k].as_f64().unwrap();
    assert!((by(0) - 6.0).abs() < 1.0 && (by(1) - 4.0).abs() < 1.0, "{}", answer["moved"]);
    let carried = answer["drawing"].clone();
    let u = |d: &Value| d["lines"][0]["points"][0][0].as_f64().unwrap();
    assert!((u(&carried) - u(&drawing) - 6.0).abs() < 1.5);
    let said = moved.refused(&carried);
    assert!(said.contains("look at the points"), "{said}");
    let mut confirmed = carried;
    confirmed["backdrop"] = answer["backdrop"].clone();
    assert_eq!(moved.post("api/save/0", &confirmed).0, 200);
}
