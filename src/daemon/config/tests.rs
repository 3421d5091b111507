use super::secrets::secret;
use super::*;

const EXAMPLE: &str = include_str!("../../../boards/linux/verge.toml");

fn parse(text: &str) -> Result<Config, String> {
    let config = Config::parse(text)?;
    config.check().map_err(|(key, reason)| format!("{key}: {reason}"))?;
    Ok(config)
}

/// The example with every commented key switched on: what it shows are the defaults.
fn example_in_full() -> String {
    let uncomment = |line: &str| match line.strip_prefix("#") {
        Some(rest) if !rest.starts_with(' ') && rest.contains(" = ") => rest.to_owned(),
        _ => line.to_owned(),
    };
    EXAMPLE.lines().map(uncomment).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_example_is_right_and_shows_the_defaults() {
    let short = parse(EXAMPLE).expect("the example as it ships");
    let full = parse(&example_in_full()).expect("the example with every key");
    assert_eq!(full.mqtt.root, Some(short.root_topic()));
    let comparable = |mut config: Config| {
        config.mqtt.root = None;
        (config.camera.user, config.camera.password_file) = (None, None);
        (config.mqtt.user, config.mqtt.password_file) = (None, None);
        (config.mqtt.tls, config.mqtt.ca_file) = (false, None);
        (config.mqtt.certificate_file, config.mqtt.key_file) = (None, None);
        (config.model.score, config.lane_table.audit) = (None, None);
        config.metrics.file = None;
        config.traffic.section_m.clear();
        (config.serial.device, config.serial.window_s) = (None, None);
        format!("{config:?}")
    };
    assert_eq!(comparable(full), comparable(short));
}

#[test]
fn what_changes_the_count_must_be_signed() {
    let config = parse(&example_in_full()).expect("the example with every key");
    let tables = &config.lane_table;
    let audit = tables.audit.clone().expect("shown in the example");
    let expected = [config.model.file.with_extension("toml"), tables.file.clone(), audit];
    assert_eq!(config.signed_files().collect::<Vec<_>>(), expected);
}

#[test]
fn wrong_keys_and_values_are_named() {
    for (from, to, expected) in [
        ("site = ", "sight = ", "sight"),
        ("interval_s = 120", "interval_s = 0", "camera.interval_s"),
        ("interval_s = 120", "interval_s = \"soon\"", "interval_s"),
        ("#timeout_s = 10.0", "timeout_s = 60", "camera.timeout_s"),
        ("site = \"k109f\"", "site = \"a/b\"", "site"),
        ("lengths_s = [300, 900]", "lengths_s = [5]", "windows.lengths_s"),
        ("lengths_s = [300, 900]", "lengths_s = []", "0 windows asked for"),
        ("lengths_s = [300, 900]", "lengths_s = [130]", "a window of 130 s: give whole seconds"),
        ("lengths_s = [300, 900]", "lengths_s = [300, 300]", "windows of 300 s twice"),
        ("lengths_s = [300, 900]", "lengths_s = [60]", "a frame every 120 s cannot fill"),
        ("#views = \"whole\"", "views = \"near\"", "near"),
        ("#watch = true", "watch = \"yes\"", "watch"),
        ("#presets = []", "presets = \"b.lut\"", "presets"),
        ("#presets = []", "presets = [\"b.lut\", \"k109f.lut\"]", "already lane_table.file"),
        ("#presets = []", "presets = [\"b.lut\", \"b.lut\"]", "b.lut twice"),
        ("#min_completeness = 0.75", "min_completeness = 75", "windows.min_completeness"),
        ("#format = \"json\"", "format = \"xml\"", "xml"),
        ("#ca_file =", "ca_file =", "mqtt.tls"),
        ("http://127.0.0.1:8080/", "rtmp://127.0.0.1/", "\"rtmp://\" is not supported"),
        ("http://127.0.0.1:8080/", "127.0.0.1/", "neither an address nor a folder"),
        ("http://127.0.0.1:8080/snapshot.jpg", " ", "it is empty; a camera's begins with"),
        ("http://127.0.0.1:8080/", "http://::1:8080/", "in brackets"),
        ("http://127.0.0.1:8080/", "http://a:b#c@127.0.0.1/", "%23"),
        ("#user = \"operator\"", "ca_file = \"camera.pem\"", "not secured by TLS"),
        ("#user = \"operator\"", "password_file = \"x\"", "camera.password_file"),
        ("#version = \"auto\"", "version = \"4\"", "3.1.1"),
        ("#host = \"127.0.0.1\"", "host = \"mqtt://127.0.0.1\"", "mqtt.host"),
        ("#host = \"127.0.0.1\"", "host = \"127.0.0.1:1883\"", "mqtt.port"),
        ("#host = \"127.0.0.1\"", "host = \" 127.0.0.1\"", "blank"),
        ("#host = \"127.0.0.1\"", "host = \"[::1]\"", "brackets"),
        ("#port = 1883", "port = 0", "mqtt.port"),
        ("site = \"k109f\"", "site = \"..\"", "stands for a folder"),
        ("site = \"k109f\"", "site = \"a\u{200b}b\"", "do not show"),
        ("site = \"k109f\"", "site = \"${HOSTNAME}\"", "placeholder"),
        ("site = \"k109f\"", "site = \" \"", "site"),
        ("#root = \"verge/k109f\"", "root = \"/city/verge/\"", "mqtt.root"),
        ("#root = \"verge/k109f\"", "root = \"$SYS/verge\"", "mqtt.root"),
        ("#replay_per_s = 10.0", "replay_per_s = 0", "mqtt.replay_per_s"),
        ("#days = 7.0", "days = 90", "spool.days"),
        ("#window_s = 300", "window_s = 60", "serial.window_s"),
        ("#baud = 115200", "baud = 5", "serial.baud"),
        ("#prefix = \"homeassistant\"", "prefix = \"a/#\"", "home_assistant.prefix"),
        ("#prefix = \"homeassistant\"", "prefix = \"homeassistant/\"", "home_assistant.prefix"),
        ("#prefix = \"homeassistant\"", "prefix = \"\"", "home_assistant.prefix"),
    ] {
        let bad = EXAMPLE.replacen(from, to, 1);
        assert_ne!(bad, EXAMPLE, "{from}");
        let error = parse(&bad).expect_err(to);
        assert!(error.contains(expected), "{to}: {error}");
    }
}

#[test]
fn a_host_without_its_beginning_is_no_missing_folder() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("verge.toml");
    let read = |source: &str| {
        std::fs::write(&file, EXAMPLE.replacen("http://127.0.0.1:8080/snapshot.jpg", source, 1))
            .expect("written");
        Config::read(&file).map(|_| ()).map_err(|error| error.to_string())
    };
    for source in [
        "camera.local/snap.jpg",
        "//camera/snap.jpg",
        "http//camera/x",
        "www.example.com",
        "0",
        "video0",
    ] {
        let error = read(source).expect_err(source);
        assert!(error.contains("neither an address nor a folder"), "{source}: {error}");
    }
    // Folders have dots too, and one may be missing for now.
    std::fs::create_dir(folder.path().join("frames.v2")).expect("made");
    for source in ["frames.v2", "../frames", "./frames", "/var/frames.v3", "frames"] {
        read(source).expect(source);
    }
}

#[test]
#[cfg(unix)]
fn a_password_that_others_can_read_is_refused() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("password");
    std::fs::write(&path, "hunter2\n").expect("writing it");
    let mode = |mode| {
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).expect("chmod");
        secret("mqtt.password_file", Some("box"), Some(&path))
    };
    let error = mode(0o644).expect_err("readable by all").to_string();
    assert!(error.contains("644") && !error.contains("hunter2"), "{error}");
    let (user, password) = mode(0o600).expect("private").expect("given");
    assert_eq!((user.as_str(), password.as_str()), ("box", "hunter2"));
}

#[test]
fn a_configuration_that_everybody_may_write_is_refused() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("verge.toml");
    std::fs::write(&path, EXAMPLE).expect("written");
    for (mode, right) in [(0o640, true), (0o664, true), (0o666, false), (0o602, false)] {
        let permissions = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(&path, permissions).expect("chmod");
        let read = Config::read(&path);
        assert_eq!(read.is_ok(), right, "{mode:03o}");
        if let Err(error) = read {
            assert!(error.to_string().contains("chmod o-w"), "{error}");
        }
    }
}

#[test]
fn sections_are_read_for_lanes_that_can_be() {
    let with = |section: &str| {
        let place = "#section_m = { 1 = 40.0 }";
        assert!(EXAMPLE.contains(place));
        parse(&EXAMPLE.replacen(place, &format!("section_m = {section}"), 1))
    };
    let config = with("{ 1 = 40.0, 3 = 12 }").expect("right");
    let sections: Vec<_> = config.traffic.sections().map(|(lane, m)| (lane.get(), m)).collect();
    assert_eq!(sections, [(1, 40.0), (3, 12.0)]);
    for wrong in ["{ 9 = 40.0 }", "{ left = 40.0 }", "{ 1 = 40.0, 01 = 50.0 }"] {
        let error = with(wrong).expect_err(wrong);
        assert!(error.contains("traffic.section_m") && error.contains("1 to 8"), "{error}");
    }
}

#[test]
fn a_camera_s_address_is_read_and_its_login_taken_apart() {
    let with = |source: &str, lines: &str| {
        let text = EXAMPLE.replacen("http://127.0.0.1:8080/snapshot.jpg", source, 1).replacen(
            "#user = \"operator\"",
            lines,
            1,
        );
        parse(&text)
    };
    let config = with(" HTTPS://admin:a%23b@camera/x?pwd=c ", "").expect("right");
    assert_eq!(config.camera.kind(), SourceKind::Network);
    let address = config.camera_address().expect("an address");
    assert_eq!(address.login, Some(("admin".to_owned(), "a#b".to_owned())));
    let error = with("http://admin:secret@camera/", "user = \"operator\"").expect_err("two logins");
    assert!(error.contains("camera.user") && !error.contains("secret"), "{error}");
    let pinned = format!("fingerprint = \"{}\"", "ab".repeat(32));
    let config = with("rtsps://camera/x", &pinned).expect("right");
    assert!(matches!(config.camera_trust(), Ok(Trust::Fingerprint(_))));
    let error = with("rtsps://camera/x", "fingerprint = \"ab\"").expect_err("too short");
    assert!(error.contains("camera.fingerprint"), "{error}");
    assert_eq!(with("/dev/video0", "").expect("a device").camera.kind(), SourceKind::Device);
    assert_eq!(with("frames.d/today", "").expect("a folder").camera.kind(), SourceKind::Folder);
}
