use super::super::head_key::HeadKind;
use super::*;

#[test]
fn the_known_sidecars_are_right() {
    for (name, text) in KNOWN {
        Sidecar::parse(text, Path::new(name)).expect(name);
    }
}

#[test]
fn wrong_values_are_named() {
    let good = KNOWN[0].1;
    for (from, to, key) in [
        ("width_px = 640", "width_px = 0", "input"),
        ("bins = 8", "bins = 1", "head.bins"),
        ("index = 2\n", "index = 80\n", "class.index"),
        ("iou = 0.6", "iou = 60", "thresholds"),
        ("57.375", "0.0", "input.std"),
        ("57.375", "inf", "input.std"),
        ("103.53", "nan", "input.mean"),
        ("score = 0.3", "score = nan", "thresholds"),
        ("\"nanodet-plus\"", "\"nanodet-minus\"", "nanodet-minus"),
        ("bins = 8", "boxes = 8", "boxes"),
        ("licence", "license", "license"),
        ("\"car\"", "\"tram\"", "tram"),
    ] {
        let bad = good.replacen(from, to, 1);
        assert_ne!(bad, good, "{from}");
        let error = Sidecar::parse(&bad, Path::new("x.toml")).expect_err(key).to_string();
        assert!(error.contains(key) && error.contains("x.toml"), "{error}");
    }
}

#[test]
fn a_head_is_a_word_a_table_or_left_out() {
    let good = KNOWN[0].1;
    let (start, rest) = good.split_once("[head]").expect("a table");
    let (_, rest) = rest.split_once("\n\n").expect("a table behind it");
    let without = format!("{start}{rest}");
    assert!(Sidecar::parse(&without, Path::new("x.toml")).expect("right").head.is_none());
    for (name, kind) in [
        ("yolox_decoded", HeadKind::YoloxDecoded),
        ("yolox-decoded", HeadKind::YoloxDecoded),
        ("yolov8", HeadKind::Yolov8),
        ("nanodet", HeadKind::NanodetPlus),
        ("end2end", HeadKind::End2end),
    ] {
        let text = format!("head = \"{name}\"\n{without}");
        let sidecar = Sidecar::parse(&text, Path::new("x.toml")).expect(name);
        let spec = sidecar.head.expect("named").spec(&[vec![1, 84, 6300]]);
        assert_eq!(spec.kind, kind);
        if kind == HeadKind::Yolov8 {
            assert_eq!(spec.classes, 80);
        }
    }
}
