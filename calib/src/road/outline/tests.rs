//! What lane files of labelme and its kin say, and what is refused by its name.

use super::*;

const SQUARE: &str = "[[100,200],[140,200],[130,100],[110,100]]";

fn file(flags: &str, shapes: &str) -> LabelFile {
    let text =
        format!(r#"{{"imageWidth":320,"imageHeight":240,"flags":{flags},"shapes":[{shapes}]}}"#);
    LabelFile::parse(text.as_bytes()).unwrap()
}

fn shape(label: &str, kind: &str, flags: &str, points: &str) -> String {
    format!(r#"{{"label":"{label}","shape_type":"{kind}","flags":{flags},"points":{points}}}"#)
}

fn refusal(flags: &str, shapes: &str) -> String {
    read(&file(flags, shapes)).unwrap_err().to_string()
}

const TOWARDS_US: &str = r#"{"toward":true}"#;

#[test]
fn a_flag_of_the_file_is_the_default_and_null_is_empty() {
    let shapes = [
        shape("1", "polygon", "null", SQUARE),
        shape("2", "polygon", r#"{"away":true,"towards":false}"#, SQUARE),
    ]
    .join(",");
    let drawing = read(&file(TOWARDS_US, &shapes)).unwrap();
    let directions: Vec<_> = drawing.lanes.iter().map(|l| l.direction).collect();
    assert_eq!(directions, [Direction::Toward, Direction::Away]);
    let refused = refusal("null", &shape("1", "polygon", "null", SQUARE));
    assert!(refused.contains("lane 1") && refused.contains("no direction"), "{refused}");
}

#[test]
fn flags_shapes_and_labels_that_are_not_known_are_named() {
    for (label, kind, flags, points, expected) in [
        ("1", "polygon", r#"{"towards":true}"#, SQUARE, "the flag 'towards' is not known"),
        ("1", "polygon", r#"{"Toward":true}"#, SQUARE, "the flag 'Toward' is not known"),
        ("1", "polygon", r#"{"toward":true,"away":true}"#, SQUARE, "both toward and away"),
        ("kerb", "polygon", TOWARDS_US, SQUARE, "no lane number"),
        ("9", "polygon", TOWARDS_US, SQUARE, "no lane number"),
        ("1", "rectangle", TOWARDS_US, "[[1,2],[3,4]]", "it is a rectangle"),
        ("1", "circle", TOWARDS_US, "[[1,2],[3,4]]", "it is a circle"),
        ("1", "point", TOWARDS_US, "[[1,2]]", "it is a point"),
        ("1", "linestrip", TOWARDS_US, SQUARE, "a lane has two edges"),
        ("1", "", TOWARDS_US, SQUARE, "labelme before version 3.4"),
        ("1", "polygon", TOWARDS_US, "[[1,2],[3,4]]", "2 corners"),
        ("1", "polygon", TOWARDS_US, "[[400,300],[420,300],[420,400],[400,400]]", "outside"),
    ] {
        let refused = refusal("{}", &shape(label, kind, flags, points));
        assert!(refused.contains(expected), "{refused}");
    }
    let refused = refusal(r#"{"weather":true}"#, &shape("1", "polygon", TOWARDS_US, SQUARE));
    assert!(refused.contains("'weather'"), "{refused}");
}

#[test]
fn an_outline_that_crosses_itself_is_named_by_its_corners() {
    let exchanged = "[[140,200],[100,200],[130,100],[110,100]]";
    let refused = refusal("{}", &shape("3", "polygon", TOWARDS_US, exchanged));
    assert!(refused.contains("lane 3") && refused.contains("crosses itself"), "{refused}");
    assert!(
        refused.contains("corners 2 and 3") && refused.contains("corners 4 and 1"),
        "{refused}"
    );
}

#[test]
fn what_lies_outside_the_picture_does_not_count() {
    let deep = "[[100,320],[140,320],[130,100],[110,100]]";
    let drawing = read(&file("{}", &shape("1", "polygon", TOWARDS_US, deep))).unwrap();
    let lowest = drawing.lanes[0].polygon.iter().map(|p| p.y).fold(0.0, f64::max);
    assert_eq!(lowest, 240.0);
    assert_eq!(drawing.lanes[0].polygon.len(), 4);
}

#[test]
fn two_lines_of_one_label_are_the_edges_of_a_lane() {
    let shapes = [
        shape("1", "linestrip", TOWARDS_US, "[[100,200],[110,100]]"),
        shape("1", "linestrip", TOWARDS_US, "[[140,200],[130,100]]"),
    ]
    .join(",");
    let drawing = read(&file("{}", &shapes)).unwrap();
    let expected = [[100.0, 200.0], [110.0, 100.0], [130.0, 100.0], [140.0, 200.0]];
    assert_eq!(drawing.lanes[0].polygon, expected.map(Vector2::from));
}

#[test]
fn polygons_and_rectangles_can_be_ignored() {
    let shapes = [
        shape("ignore", "rectangle", "{}", "[[0,0],[50,12]]"),
        shape("Ignore", "polygon", "{}", SQUARE),
    ]
    .join(",");
    let drawing = read(&file("{}", &shapes)).unwrap();
    assert_eq!((drawing.ignored.len(), drawing.lanes.len()), (2, 0));
    assert_eq!(drawing.ignored[0][2], Vector2::new(50.0, 12.0));
}

#[test]
fn lanes_of_one_number_are_refused() {
    let both =
        [shape("1", "polygon", TOWARDS_US, SQUARE), shape("a1", "polygon", TOWARDS_US, SQUARE)];
    assert!(refusal("{}", &both.join(",")).contains("drawn twice"));
}

#[test]
fn files_of_other_programs_are_named() {
    let refused = |text: &str| LabelFile::parse(text.as_bytes()).unwrap_err();
    for (text, expected) in [
        (r#"{"images":[],"annotations":[],"categories":[]}"#, "COCO"),
        (r#"{"a.jpg1":{"filename":"a.jpg","regions":[]}}"#, "VIA"),
        (r#"{"_via_settings":{},"_via_img_metadata":{}}"#, "VIA"),
        (r#"{"shapes":[],"version":"3.16.7"}"#, "labelme before version 4"),
        (r#"{"shapes":[],"imageWidth":null,"imageHeight":null}"#, "labelme before version 4"),
        (r#"{"type":"FeatureCollection"}"#, "no shapes"),
        ("[1,2]", "no shapes"),
        (r#"{"shapes":[{"label":"1","points":[[NaN,5]]}]}"#, "NaN or infinite"),
    ] {
        let message = refused(text);
        assert!(message.contains(expected), "{message}");
    }
    assert!(LabelFile::parse(b"{\"imagePath\":\"\xc2\xb7\xb7\"}").unwrap_err().contains("UTF-8"));
    let marked = "\u{feff}{\"imageWidth\":2,\"imageHeight\":2,\"shapes\":[]}";
    assert!(LabelFile::parse(marked.as_bytes()).is_ok());
    let group = |group: &str| {
        let text = format!(
            r#"{{"imageWidth":2,"imageHeight":2,"flags":null,"shapes":[{{"label":"1","points":[],"group_id":{group},"description":null}}]}}"#
        );
        LabelFile::parse(text.as_bytes()).map(|f| f.shapes[0].group_id)
    };
    assert_eq!((group("1.0"), group("\"\""), group("null")), (Ok(Some(1)), Ok(None), Ok(None)));
    assert!(group("1.5").is_err());
}
