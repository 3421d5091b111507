//! The order in which standing and driving things are painted: from far to near.
//!
//! Owns the sort that picture and outlines share. Short things go by the distance of their middles.
//! A long lorry beside one of them may have the nearer middle and yet lie behind, so beside it the
//! side from which the camera looks decides.

use nalgebra::Point3;

use crate::simulation::Placed;

/// Vehicles longer than this are compared by side, m: longer than a bus.
const LONG_M: f64 = 13.0;

/// True for a vehicle longer than a bus.
pub fn is_long(vehicle: &Placed) -> bool {
    vehicle.model().length_m() > LONG_M
}

/// How far beyond its ends a lorry is still beside something, m: half a car.
const BESIDE_M: f64 = 2.5;

/// Something to paint: its distance on the ground, where its middle is, and what it is.
pub struct Item<T> {
    /// Distance of the middle from the camera's foot, m.
    pub distance: f64,
    /// Middle, world (X, Y) m.
    pub middle: [f64; 2],
    /// What it is.
    pub what: T,
}

/// Moves items that stand beside a long vehicle behind or before it, by changing the distance by
/// which they are sorted. Leaves all as they are where nothing is long.
pub fn settle<T>(items: &mut [Item<T>], vehicles: &[Placed], eye: &Point3<f64>) {
    for lorry in vehicles.iter().filter(|vehicle| is_long(vehicle)) {
        let own = (lorry.centre[0] - eye.x).hypot(lorry.centre[1] - eye.y);
        let [middle_x, middle_y] = lorry.model().centre_m();
        let reach = lorry.model().length_m() / 2.0 + BESIDE_M;
        let half = lorry.model().width_m() / 2.0;
        let aside = |x: f64, y: f64| {
            let p = lorry.model_point(&Point3::new(x, y, 0.0));
            [p.x - middle_x, p.y - middle_y]
        };
        let [eye_side, _] = aside(eye.x, eye.y);
        if eye_side.abs() < half {
            // The camera looks along it: nothing beside it is behind it.
            continue;
        }
        for item in items.iter_mut() {
            let [side, along] = aside(item.middle[0], item.middle[1]);
            if along.abs() > reach || side.abs() < half {
                continue;
            }
            // A thousandth of its own distance keeps the order among those that are moved.
            let near = side * eye_side > 0.0;
            if near && item.distance > own {
                item.distance = own - 1.0 + item.distance * 1e-3;
            } else if !near && item.distance < own {
                item.distance = own + item.distance * 1e-3;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::{Item, settle};
    use crate::random::Stream;
    use crate::simulation::Placed;
    use crate::vehicle::paint::Livery;
    use crate::vehicle::{ARTICULATED, Class};

    /// A vehicle that drives along +Y, its middle at (4, 40).
    fn placed(model_index: usize) -> Placed {
        Placed {
            id: 1,
            model_index,
            lane: 0,
            lane_s_m: 40.0,
            speed_m_s: 0.0,
            braking: false,
            livery: Livery::draw(Class::Truck, 0.0, &mut Stream::new(1, "order")),
            centre: [4.0, 40.0],
            heading: [0.0, 1.0],
        }
    }

    /// The order, from far to near, of a lorry at 40 m and a car at `place` beside or near it, seen
    /// from the origin; true where the lorry is painted last.
    fn lorry_last(model_index: usize, place: [f64; 2]) -> bool {
        let lorry = placed(model_index);
        let item = |middle: [f64; 2], what| {
            let distance = middle[0].hypot(middle[1]);
            Item { distance, middle, what }
        };
        let mut items = [item(lorry.centre, "lorry"), item(place, "car")];
        settle(&mut items, &[lorry], &Point3::new(0.0, 0.0, 10.0));
        items[0].distance < items[1].distance
    }

    #[test]
    fn beside_a_long_lorry_the_side_decides() {
        // The tail of the lorry stands before a car in the lane beyond, whose middle is nearer.
        assert!(lorry_last(ARTICULATED, [7.5, 35.0]));
        assert!(!lorry_last(ARTICULATED, [0.5, 45.0]));
        // In its own lane and for short vehicles the distance does.
        assert!(lorry_last(ARTICULATED, [4.0, 60.0]) && !lorry_last(ARTICULATED, [4.0, 20.0]));
        assert!(!lorry_last(ARTICULATED - 2, [7.5, 35.0]));
    }
    #[test]
    fn a_lorry_hides_a_lamp_behind_it_and_none_beside_it() {
        let lorry = placed(ARTICULATED);
        let (eye, lamp) = (Point3::new(4.0, 0.0, 10.0), |x, y| Point3::new(x, y, 0.8));
        assert!(lorry.hides(&lamp(4.0, 50.0), &eye));
        assert!(!lorry.hides(&lamp(4.0, 30.0), &eye) && !lorry.hides(&lamp(8.0, 50.0), &eye));
    }
}
