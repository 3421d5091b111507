//! The order in which standing and driving things are painted: from far to near.
//!
//! Owns the sort that picture and outlines share. Short things go by the distance of their middles.
//! Beside a long lorry that fails, so where there is one, a line on the ground that separates two
//! things decides which is in front.

use nalgebra::Point3;

use crate::simulation::Placed;
use crate::solid::Block;

/// Vehicles longer than this need more than the distance of their middles, m: longer than a bus.
const LONG_M: f64 = 13.0;

/// Things that overlap by less than this still count as apart, m.
const TOUCH_M: f64 = 0.05;

/// True for a vehicle longer than a bus.
pub fn is_long(vehicle: &Placed) -> bool {
    vehicle.model().length_m() > LONG_M
}

/// Something to paint: its distance, where it stands on the ground, and what it is.
pub struct Item<T> {
    /// Distance of the middle from the camera's foot, m.
    pub distance: f64,
    middle: [f64; 2],
    foot: [[f64; 2]; 4],
    /// What it is.
    pub what: T,
}

impl<T> Item<T> {
    /// A vehicle, seen from `eye`.
    pub fn vehicle(vehicle: &Placed, eye: &Point3<f64>, what: T) -> Self {
        let ([x0, x1], [y0, y1]) = (vehicle.model().sides_m, vehicle.model().ends_m);
        let foot = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|[x, y]| {
            let p = vehicle.world([x, y, 0.0]);
            [p.x, p.y]
        });
        Item::new(vehicle.centre, foot, eye, what)
    }

    /// A piece of a barrier or a closure, seen from `eye`.
    pub fn block(block: &Block, eye: &Point3<f64>, what: T) -> Self {
        Item::new(block.middle, block.foot, eye, what)
    }

    fn new(middle: [f64; 2], foot: [[f64; 2]; 4], eye: &Point3<f64>, what: T) -> Self {
        let distance = (middle[0] - eye.x).hypot(middle[1] - eye.y);
        Item { distance, middle, foot, what }
    }

    /// The bearings under which it stands: of its middle, and of its edges against that, radians.
    fn bearings(&self, eye: &Point3<f64>) -> [f64; 3] {
        let bearing = |p: [f64; 2]| (p[0] - eye.x).atan2(p[1] - eye.y);
        let middle = bearing(self.middle);
        let edges = self.foot.map(|p| wrapped(bearing(p) - middle));
        [middle, edges.into_iter().fold(0.0, f64::min), edges.into_iter().fold(0.0, f64::max)]
    }

    /// True when this one is in front of `other`, `None` when they stand in one another. Of the
    /// lines along their sides the one decides that leaves the widest gap: what lies on the eye's
    /// side of it is in front.
    fn before(&self, other: &Self, eye: &Point3<f64>) -> Option<bool> {
        let (mut widest, mut before) = (-TOUCH_M, None);
        for (owner, guest, own) in [(self, other, true), (other, self, false)] {
            for k in 0..4 {
                let ([x, y], [to_x, to_y]) = (owner.foot[k], owner.foot[(k + 1) % 4]);
                let length = (to_x - x).hypot(to_y - y);
                if length < 1e-9 {
                    continue;
                }
                let side =
                    |p: [f64; 2]| ((p[0] - x) * (to_y - y) - (p[1] - y) * (to_x - x)) / length;
                let inward = side(owner.middle).signum();
                let gap =
                    guest.foot.map(|p| -inward * side(p)).into_iter().fold(f64::MAX, f64::min);
                if gap > widest {
                    widest = gap;
                    before = Some((inward * side([eye.x, eye.y]) >= 0.0) == own);
                }
            }
        }
        before
    }
}

/// The items from far to near; those at one distance stay in their order. With a long vehicle in the
/// street each comes after all that it stands in front of.
pub fn far_to_near<T>(
    mut items: Vec<Item<T>>,
    vehicles: &[Placed],
    eye: &Point3<f64>,
) -> Vec<Item<T>> {
    items.sort_by(|a, b| b.distance.total_cmp(&a.distance));
    if !vehicles.iter().any(is_long) {
        return items;
    }
    let bearings: Vec<_> = items.iter().map(|item| item.bearings(eye)).collect();
    let mut behind = vec![Vec::new(); items.len()];
    for far in 0..items.len() {
        for near in far + 1..items.len() {
            if !overlap(bearings[far], bearings[near]) {
                continue;
            }
            match items[far].before(&items[near], eye) {
                Some(true) => behind[far].push(near),
                _ => behind[near].push(far),
            }
        }
    }
    let mut order = Vec::with_capacity(items.len());
    let mut seen = vec![false; items.len()];
    for i in 0..items.len() {
        place(i, &behind, &mut seen, &mut order);
    }
    let mut items: Vec<_> = items.into_iter().map(Some).collect();
    order.into_iter().filter_map(|i| items[i].take()).collect()
}

/// Places what is behind an item, then the item. A ring, of which each covers the next, is cut where
/// it was entered.
fn place(i: usize, behind: &[Vec<usize>], seen: &mut [bool], order: &mut Vec<usize>) {
    if !std::mem::replace(&mut seen[i], true) {
        for j in &behind[i] {
            place(*j, behind, seen, order);
        }
        order.push(i);
    }
}

fn overlap(a: [f64; 3], b: [f64; 3]) -> bool {
    let turn = wrapped(b[0] - a[0]);
    turn + b[1] < a[2] && turn + b[2] > a[1]
}

/// An angle from minus half a turn to half a turn, radians.
fn wrapped(angle: f64) -> f64 {
    angle - (angle / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::{Item, far_to_near, overlap};
    use crate::random::Stream;
    use crate::simulation::Placed;
    use crate::vehicle::paint::Livery;
    use crate::vehicle::{ARTICULATED, Class};

    const EYE: Point3<f64> = Point3::new(0.0, 0.0, 10.0);

    /// A vehicle that drives along +Y.
    fn placed(model_index: usize, centre: [f64; 2]) -> Placed {
        Placed {
            id: 1,
            model_index,
            lane: 0,
            lane_s_m: 40.0,
            speed_m_s: 0.0,
            braking: false,
            livery: Livery::draw(Class::Truck, 0.0, &mut Stream::new(1, "order")),
            centre,
            heading: [0.0, 1.0],
        }
    }

    /// The places of vehicles in the list, from far to near.
    fn order(vehicles: &[Placed], eye: &Point3<f64>) -> Vec<usize> {
        let item = |(i, vehicle)| Item::vehicle(vehicle, eye, i);
        let items = vehicles.iter().enumerate().map(item).collect();
        far_to_near(items, vehicles, eye).into_iter().map(|item| item.what).collect()
    }

    /// True where a lorry at (4, 40) is painted after a car at `place`, seen from (-8, 0).
    fn lorry_last(model_index: usize, place: [f64; 2]) -> bool {
        let eye = Point3::new(-8.0, 0.0, 10.0);
        order(&[placed(model_index, [4.0, 40.0]), placed(0, place)], &eye) == [1, 0]
    }

    #[test]
    fn beside_a_long_lorry_the_side_decides() {
        // The tail of the lorry stands before a car in the lane beyond, whose middle is nearer.
        assert!(lorry_last(ARTICULATED, [7.5, 35.0]));
        assert!(!lorry_last(ARTICULATED, [0.9, 42.0]));
        // In its own lane and for short vehicles the distance does.
        assert!(lorry_last(ARTICULATED, [4.0, 60.0]) && !lorry_last(ARTICULATED, [4.0, 20.0]));
        assert!(!lorry_last(ARTICULATED - 2, [7.5, 35.0]));
    }

    #[test]
    fn cars_beside_a_lorry_keep_their_own_order() {
        let [near, far] = [[0.5, 39.6], [0.5, 45.0]].map(|place| placed(0, place));
        assert_eq!(order(&[placed(ARTICULATED, [4.0, 40.0]), near, far], &EYE), [2, 0, 1]);
    }

    #[test]
    fn lorries_side_by_side_are_painted_from_the_farthest_lane_on() {
        // Each middle is nearer than that of the lorry before it, which hides it.
        let eye = Point3::new(-10.0, 0.0, 10.0);
        let mut lorries = [[4.0, 46.0], [7.6, 40.0], [11.2, 34.0]].map(|p| placed(ARTICULATED, p));
        assert_eq!(order(&lorries, &eye), [2, 1, 0]);
        lorries.reverse();
        assert_eq!(order(&lorries, &eye), [0, 1, 2]);
    }

    /// How far a ray from the origin goes until a vehicle stops it, m.
    fn enter(vehicle: &Placed, [x, y]: [f64; 2]) -> f64 {
        let half = [vehicle.model().width_m() / 2.0, vehicle.model().length_m() / 2.0];
        let wall = |k: usize, way: f64| (vehicle.centre[k] - half[k] * way.signum()) / way;
        wall(0, x).max(wall(1, y))
    }

    #[test]
    fn in_dense_traffic_with_lorries_no_pair_is_wrong() {
        let (mut pairs, mut wrong, mut by_distance) = (0, 0, 0);
        let mut draw = Stream::new(1, "traffic");
        for _ in 0..100 {
            let mut vehicles = vec![placed(ARTICULATED, [20.0, 40.0])];
            for lane in 0..4 {
                let mut y = draw.range(12.0, 25.0);
                while y < 110.0 {
                    let index = if draw.unit() < 0.25 { ARTICULATED } else { 0 };
                    let mut vehicle = placed(index, [2.0 + 3.6 * f64::from(lane), 0.0]);
                    vehicle.centre[1] = y + vehicle.model().length_m() / 2.0;
                    y += vehicle.model().length_m() + draw.range(1.5, 8.0);
                    vehicles.push(vehicle);
                }
            }
            let order = order(&vehicles, &EYE);
            assert_eq!(order.len(), vehicles.len());
            for (n, near) in order.iter().enumerate() {
                for far in &order[..n] {
                    let items = [*far, *near].map(|i| Item::vehicle(&vehicles[i], &EYE, i));
                    let [a, b] = [items[0].bearings(&EYE), items[1].bearings(&EYE)];
                    if !overlap(a, b) {
                        continue;
                    }
                    let middle =
                        ((a[0] + a[1]).max(b[0] + b[1]) + (a[0] + a[2]).min(b[0] + b[2])) / 2.0;
                    let way = [middle.sin(), middle.cos()];
                    let [a, b] = [*far, *near].map(|i| enter(&vehicles[i], way));
                    pairs += 1;
                    wrong += usize::from(a < b);
                    by_distance += usize::from((a < b) == (items[0].distance > items[1].distance));
                }
            }
        }
        println!("{wrong} of {pairs} pairs are wrong, by distance alone {by_distance}");
        assert!(wrong == 0 && by_distance > 50 && pairs > 5000);
    }

    #[test]
    fn a_lorry_hides_a_lamp_behind_it_and_none_beside_it() {
        let lorry = placed(ARTICULATED, [4.0, 40.0]);
        let (eye, lamp) = (Point3::new(4.0, 0.0, 10.0), |x, y| Point3::new(x, y, 0.8));
        assert!(lorry.hides(&lamp(4.0, 50.0), &eye));
        assert!(!lorry.hides(&lamp(4.0, 30.0), &eye) && !lorry.hides(&lamp(8.0, 50.0), &eye));
    }
}
