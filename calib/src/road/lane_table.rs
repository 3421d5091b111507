//! The lane table of a calibrated camera: for every pixel its lane and place along it.
//!
//! Owns filling the cells and the stated errors. Does not own the file's format (the core
//! crate's `lane` module), lanes on the road (see `drawn_lane`) nor centre lines (see `lane_axis`).

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files::calibration::{Calibration, Sha256};
use crate::road::drawn_lane::DrawnLane;
use crate::road::judge::judge_lanes;
use crate::road::lane_axis::LaneAxis;
use crate::road::outline::contains;
use nalgebra::Vector2;
use rayon::prelude::*;
use verge::lane::{Description, Lane, LaneErrors, LaneTableError, Name, Place};
use verge::scene::Reference;
use verge::units::ImageSize;

/// Part of a lane's cells that another lane may claim too: hand-drawn borders cross by a
/// pixel here and there.
const OVERLAP_FRACTION: f64 = 0.02;
/// Cells that two lanes may share whatever their size.
const OVERLAP_CELLS: usize = 8;

/// The bytes of a lane table.
///
/// `sha256` is the hash of the calibration file, `fallback_id` names the camera where the
/// calibration does not, `scene` is the reference by which a moved camera is noticed,
/// `cell_length_m` is the approximate length of the cells along a lane.
pub fn table(
    calibration: &Calibration,
    lanes: &[DrawnLane],
    sha256: Sha256,
    fallback_id: &str,
    scene: Option<&Reference>,
    cell_length_m: f32,
) -> Result<Vec<u8>> {
    let camera = calibration.camera();
    let cells = cells(&camera, lanes)?;
    let [width, height] = camera.image_size;
    let side = |px: u32| {
        u16::try_from(px)
            .map_err(|_| Error::Usage(format!("a picture side of {px} px is too long")))
    };
    let image_size = ImageSize { width: side(width)?, height: side(height)? };
    let described = |l: &DrawnLane| Lane {
        id: l.id,
        direction: l.direction,
        length_m: l.axis.length_m() as f32,
    };
    let description = Description {
        camera_id: Name::truncated(calibration.camera_id.as_deref().unwrap_or(fallback_id)),
        image_size,
        lanes: lanes.iter().map(described).collect(),
        length_rel_err: calibration.rel_err.map(|e| e as f32),
        calibration_id: Name::truncated(&format!("{}-{sha256}", calibration.method)),
        calibration_sha256: sha256.0,
        cell_length_m,
    };
    let known = calibration.known();
    let judged = judge_lanes(lanes, &camera, known.as_ref(), cell_length_m);
    let cell_errors: Vec<Vec<f32>> = judged
        .iter()
        .map(|j| j.geometry.cell_rel_err.iter().map(|e| *e as f32).collect())
        .collect();
    let errors: Vec<LaneErrors<'_>> = judged
        .iter()
        .zip(&cell_errors)
        .filter_map(|(j, cells)| Some(LaneErrors { lane: Some(j.geometry.rel_err? as f32), cells }))
        .collect();
    // All or none: a lane without a stated error has the calibration's.
    let errors = if errors.len() == lanes.len() { &errors[..] } else { &[] };
    let mut bytes = vec![0; verge::lane::encoded_len_with_errors(&description, errors, scene)];
    let at = |u: u16, v: u16| cells[usize::from(v) * width as usize + usize::from(u)];
    let refused = |e: LaneTableError| Error::Solver { method: "lane table", detail: e.to_string() };
    let length = verge::lane::encode_with_errors(&description, errors, scene, at, &mut bytes)
        .map_err(refused)?;
    bytes.truncate(length);
    Ok(bytes)
}

/// Whether lanes claim the same pixels.
///
/// # Errors
/// Names the first two that do.
pub fn require_apart(lanes: &[DrawnLane], image_size: [u32; 2]) -> Result<()> {
    let [width, height] = image_size.map(|px| px as usize);
    let boxes: Vec<_> = lanes.iter().map(|l| bounds(&l.polygon)).collect();
    let (mut own, mut shared) = (vec![0; lanes.len()], Vec::new());
    for v in 0..height {
        for u in 0..width {
            let uv = Vector2::new(u as f64 + 0.5, v as f64 + 0.5);
            let near =
                |k: &usize| (0..2).all(|a| (boxes[*k][a][0]..=boxes[*k][a][1]).contains(&uv[a]));
            let mut inside =
                (0..lanes.len()).filter(near).filter(|&k| contains(&lanes[k].polygon, uv));
            if let Some(first) = inside.next() {
                own[first] += 1;
                shared.extend(inside.map(|other| (first, other)));
            }
        }
    }
    check_overlaps(lanes, &own, &shared)
}

/// Least and largest coordinate along each axis, px.
fn bounds(polygon: &[Vector2<f64>]) -> [[f64; 2]; 2] {
    [0, 1].map(|axis| {
        polygon.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| {
            [low.min(p[axis]), high.max(p[axis])]
        })
    })
}

/// The content of every cell, in row order.
fn cells(camera: &Camera, lanes: &[DrawnLane]) -> Result<Vec<Option<Place>>> {
    let [width, height] = camera.image_size.map(|px| px as usize);
    type Row = (Vec<Option<Place>>, Vec<(usize, usize)>);
    let rows: Vec<Row> = (0..height)
        .into_par_iter()
        .map(|v| {
            let mut overlaps = Vec::new();
            let row = (0..width)
                .map(|u| {
                    let uv = Vector2::new(u as f64 + 0.5, v as f64 + 0.5);
                    let mut inside = (0..lanes.len()).filter(|&k| contains(&lanes[k].polygon, uv));
                    let first = inside.next()?;
                    overlaps.extend(inside.map(|other| (first, other)));
                    place(camera, &lanes[first], uv)
                })
                .collect();
            (row, overlaps)
        })
        .collect();
    let overlaps: Vec<(usize, usize)> = rows.iter().flat_map(|(_, o)| o).copied().collect();
    let cells: Vec<Option<Place>> = rows.into_iter().flat_map(|(row, _)| row).collect();
    let own = |lane: &DrawnLane| cells.iter().flatten().filter(|p| p.lane == lane.id).count();
    check_overlaps(lanes, &lanes.iter().map(own).collect::<Vec<_>>(), &overlaps)?;
    Ok(cells)
}

fn place(camera: &Camera, lane: &DrawnLane, uv: Vector2<f64>) -> Option<Place> {
    let p = camera.back_project(&uv, 0.0)?.xy();
    let station = lane.axis.station(p);
    let span_m = LaneAxis::span_m(camera, p, station.tangent) as f32;
    Some(Place { lane: lane.id, s_m: station.s_m as f32, span_m })
}

/// `own` is the number of each lane's cells.
fn check_overlaps(lanes: &[DrawnLane], own: &[usize], overlaps: &[(usize, usize)]) -> Result<()> {
    for (k, (lane, &own)) in lanes.iter().zip(own).enumerate() {
        if own == 0 {
            let problem = "covers no pixel centre of the picture; draw it larger".into();
            return Err(Error::Lane { lane: lane.id.get().to_string(), problem });
        }
        let limit = OVERLAP_CELLS.max((OVERLAP_FRACTION * own as f64) as usize);
        for (o, other) in lanes.iter().enumerate().skip(k + 1) {
            let shared = overlaps.iter().filter(|&&pair| pair == (k, o)).count();
            if shared > limit {
                let other = other.id.get();
                let problem = format!(
                    "overlaps lane {other} in {shared} pixels (limit {limit}); draw the border once"
                );
                return Err(Error::Lane { lane: lane.id.get().to_string(), problem });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::labelme::LabelFile;
    use crate::road::drawn_lane::lanes;
    use crate::road::lane_axis::tests::{camera, picture};
    use verge::lane::LaneTable;
    use verge::units::ImagePoint;

    fn file(lanes: &[(&str, &str, [[f64; 2]; 4])]) -> LabelFile {
        let camera = camera();
        let shapes: Vec<String> = lanes
            .iter()
            .map(|(label, flags, ground)| {
                let points: Vec<_> =
                    picture(&camera, ground).iter().map(|p| format!("[{},{}]", p.x, p.y)).collect();
                let points = points.join(",");
                format!(r#"{{"label":"{label}","shape_type":"polygon","flags":{{{flags}}},"points":[{points}]}}"#)
            })
            .collect();
        let shapes = shapes.join(",");
        let text = format!(r#"{{"imageWidth":320,"imageHeight":240,"shapes":[{shapes}]}}"#);
        serde_json::from_str(&text).unwrap()
    }

    const AWAY: &str = r#""away":true"#;
    const NEAR: [[f64; 2]; 4] = [[-3.2, 25.0], [-0.1, 25.0], [-0.1, 75.0], [-3.2, 75.0]];
    const FAR: [[f64; 2]; 4] = [[0.1, 25.0], [3.2, 25.0], [3.2, 65.0], [0.1, 65.0]];

    #[test]
    fn a_table_says_where_each_pixel_lies() {
        let camera = camera();
        let file = file(&[("lane_2", r#""toward":true"#, FAR), ("1", AWAY, NEAR)]);
        let lanes = lanes(&file, "lanes.json", &camera).unwrap();
        let mut calibration = Calibration::of_camera(&camera, "joint");
        calibration.rel_err = Some(0.057);
        let bytes = table(&calibration, &lanes, Sha256([7; 32]), "camera", None, 10.0).unwrap();
        let table = LaneTable::parse(&bytes[..]).unwrap();
        let description = table.description();
        assert_eq!(description.lanes.len(), 2);
        assert!((description.lanes[1].length_m - 40.0).abs() < 1e-3);
        assert_eq!((description.length_rel_err, description.cell_length_m), (Some(0.057), 10.0));
        assert_eq!(description.calibration_id.as_str(), "joint-07070707");
        for (x, y, lane, s) in [(-1.6, 45.0, 1, 20.0), (1.6, 45.0, 2, 20.0), (1.6, 60.0, 2, 5.0)] {
            let uv = camera.project(&nalgebra::Vector3::new(x, y, 0.0)).unwrap();
            let place =
                table.place(ImagePoint { u: uv.x as f32, v: uv.y as f32 }).expect("on a lane");
            assert_eq!(place.lane.get(), lane);
            // The cell stands for its centre, up to half a pixel away.
            assert!((f64::from(place.s_m) - s).abs() < 0.6 * f64::from(place.span_m) + 0.01);
        }
    }

    #[test]
    fn overlapping_and_unnumbered_lanes_are_named() {
        let camera = camera();
        let both = file(&[
            ("1", AWAY, NEAR),
            ("4", AWAY, [[-2.0, 25.0], [1.0, 25.0], [1.0, 75.0], [-2.0, 75.0]]),
        ]);
        let drawn = lanes(&both, "lanes.json", &camera).unwrap();
        let calibration = Calibration::of_camera(&camera, "joint");
        let error =
            table(&calibration, &drawn, Sha256([0; 32]), "c", None, 10.0).unwrap_err().to_string();
        assert!(error.contains("lane 1") && error.contains("lane 4"), "{error}");
        for label in ["kerb", "lane 0", "lane 9"] {
            assert!(lanes(&file(&[(label, AWAY, NEAR)]), "lanes.json", &camera).is_err());
        }
    }

    #[test]
    fn another_picture_size_is_refused() {
        let mut camera = camera();
        let file = file(&[("1", AWAY, NEAR)]);
        camera.image_size = [640, 480];
        assert!(matches!(lanes(&file, "lanes.json", &camera), Err(Error::ImageSize { .. })));
    }
}
