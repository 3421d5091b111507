//! Measures, rectangles of labelme, and marks that cannot be.

use super::*;

#[test]
fn the_measures_are_the_textbook_ones() {
    let a = Accuracy::of(&[(0.5, 5.0), (-1.0, 10.0)]);
    assert!((a.rmse_m - 0.625f64.sqrt()).abs() < 1e-12);
    assert_eq!((a.mae_m, a.mape_pct, a.bias_m, a.bias_pct), (0.75, 10.0, -0.25, 0.0));
    assert_eq!(a.segments, 2);
}

fn shape(label: &str, shape_type: &str, points: usize) -> Shape {
    let corners = [[10.0, 90.0], [60.0, 90.0], [50.0, 50.0], [20.0, 50.0], [15.0, 70.0]];
    Shape {
        label: label.into(),
        points: corners[..points].to_vec(),
        shape_type: shape_type.into(),
        group_id: None,
        flags: Default::default(),
    }
}

#[test]
fn a_rectangle_is_a_polygon_of_four_corners_with_or_without_its_sides() {
    let read = |label: &str| Rectangle::of_shape(&shape(label, "polygon", 4)).unwrap().sides_m;
    assert_eq!(read("rectangle"), None);
    assert_eq!(read("parking bay"), None);
    assert_eq!(read("rectangle 12 x 3.5 m"), Some([12.0, 3.5]));
    assert_eq!(read("5m x 2.5m"), Some([5.0, 2.5]));
    for (label, kind, points, expected) in [
        ("rectangle", "polygon", 5, "four corners"),
        ("rectangle", "rectangle", 2, "upright in the picture"),
        ("rectangle 12", "polygon", 4, "both sides"),
        ("rectangle 12 x y", "polygon", 4, "both sides"),
    ] {
        let error = Rectangle::of_shape(&shape(label, kind, points)).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains(label), "{error}");
    }
}

#[test]
fn impossible_marks_are_named() {
    let mark =
        |points, metres| Marks { marks: vec![Mark::new(points, metres)], rectangles: Vec::new() };
    assert!(mark(vec![[1.0, 2.0]], 6.0).check().is_err());
    assert!(mark(vec![[1.0, 2.0], [3.0, 4.0]], 0.0).check().is_err());
    assert!(mark(vec![[1.0, f64::NAN], [3.0, 4.0]], 6.0).check().is_err());
}
