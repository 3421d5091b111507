//! Upright blocks along the road: barriers and hedges, cut into short pieces, closures and cones.
//!
//! Owns their geometry, shared by the picture and the outlines. Owns no colours.

use nalgebra::Point3;

use crate::road::Road;
use crate::scene::{Closure, ClosureKind};
use crate::simulation::Simulation;

/// Length of a piece, m: short enough to sort by distance among vehicles.
const PIECE_M: f64 = 4.0;

/// What a block is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// Concrete of a barrier.
    Concrete,
    /// Leaves of a hedge.
    Hedge,
    /// Light concrete of an element.
    Element,
    /// Red plastic.
    Red,
    /// White plastic.
    White,
}

/// One piece of a barrier.
#[derive(Debug, Clone)]
pub struct Block {
    /// Foot of the corners, world (X, Y) m, around the piece.
    pub foot: [[f64; 2]; 4],
    /// Middle of the foot, m.
    pub middle: [f64; 2],
    /// Height of the top over the road, m.
    pub height_m: f64,
    /// Height of the foot over the road, m.
    pub foot_m: f64,
    /// Size of the top against the foot, 0 to 1.
    pub taper: f64,
    /// What it is made of.
    pub surface: Surface,
    /// It stands alone on the road, and its shadow is seen.
    pub shadow: bool,
}

impl Block {
    /// The eight corners, feet first.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        let top = |k: usize, foot: f64| match self.taper {
            1.0 => foot,
            taper => self.middle[k] + taper * (foot - self.middle[k]),
        };
        let low = |i: usize| Point3::new(self.foot[i][0], self.foot[i][1], self.foot_m);
        let high = |i: usize| {
            let [x, y] = self.foot[i];
            Point3::new(top(0, x), top(1, y), self.height_m)
        };
        [low(0), low(1), low(2), low(3), high(0), high(1), high(2), high(3)]
    }
}

/// All barrier pieces of a street.
pub fn barrier_blocks(street: &Simulation) -> Vec<Block> {
    let road = street.road();
    let mut blocks = Vec::new();
    for barrier in &street.scene().roadside.barriers {
        let pieces = (road.length_m() / PIECE_M) as usize;
        for i in 0..pieces {
            let (near, far) = (road.at(i as f64 * PIECE_M), road.at((i + 1) as f64 * PIECE_M));
            let (left, right) = (
                barrier.offset_m - barrier.width_m / 2.0,
                barrier.offset_m + barrier.width_m / 2.0,
            );
            let foot = [near.beside(left), near.beside(right), far.beside(right), far.beside(left)];
            let middle = road.at((i as f64 + 0.5) * PIECE_M).beside(barrier.offset_m);
            blocks.push(Block {
                foot,
                middle,
                height_m: barrier.height_m,
                foot_m: 0.0,
                taper: 1.0,
                surface: if barrier.hedge { Surface::Hedge } else { Surface::Concrete },
                shadow: false,
            });
        }
    }
    for closure in &street.scene().roadside.closures {
        close(closure, road, &mut blocks);
    }
    blocks
}

/// The bands of a cone: foot plate, body, white sleeve, tip.
const CONE: [(f64, f64, f64, Surface); 4] = [
    // From this share of the height to that, size against the foot, surface.
    (0.0, 0.06, 1.0, Surface::Red),
    (0.06, 0.45, 0.75, Surface::Red),
    (0.45, 0.75, 0.45, Surface::White),
    (0.75, 1.0, 0.25, Surface::Red),
];

fn close(closure: &Closure, road: &Road, blocks: &mut Vec<Block>) {
    let kind = closure.kind;
    let pitch = kind.length_m() + closure.gap_m.unwrap_or(kind.gap_m());
    let end_m = closure.to_offset_m.unwrap_or(closure.offset_m);
    let last_m = closure.to_m.min(road.length_m()) - kind.length_m() / 2.0;
    let middles = (0..).map(|i| closure.from_m + (f64::from(i) + 0.5) * pitch);
    // A row that its elements fill keeps the last one.
    for (i, s) in middles.take_while(|s| *s < last_m + 1e-6).enumerate() {
        let along = (s - closure.from_m) / (closure.to_m - closure.from_m);
        let d = closure.offset_m + along * (end_m - closure.offset_m);
        let half = [kind.width_m() / 2.0, kind.length_m() / 2.0];
        let foot = |scale: f64| {
            let corner = |x: f64, y: f64| road.at(s + y * scale).beside(d + x * scale);
            let [x, y] = half;
            [corner(-x, -y), corner(x, -y), corner(x, y), corner(-x, y)]
        };
        let middle = road.at(s).beside(d);
        let height_m = kind.height_m();
        if kind == ClosureKind::Cone {
            for (low, high, size, surface) in CONE {
                let (foot_m, height_m) = (low * height_m, high * height_m);
                let (foot, shadow) = (foot(size), true);
                blocks.push(Block { foot, middle, height_m, foot_m, taper: 0.7, surface, shadow });
            }
            continue;
        }
        let surface = match kind {
            ClosureKind::Water if i % 2 == 0 => Surface::Red,
            ClosureKind::Water => Surface::White,
            _ => Surface::Element,
        };
        let (foot, foot_m) = (foot(1.0), 0.0);
        blocks.push(Block { foot, middle, height_m, foot_m, taper: 0.6, surface, shadow: true });
    }
}

#[cfg(test)]
mod tests {
    use super::{Block, close};
    use crate::road::{Piece, Road};
    use crate::scene::{Closure, ClosureKind};

    /// The pieces of a row on 60 m of straight road along +Y.
    fn row(kind: ClosureKind, from_m: f64, to_m: f64, gap_m: f64) -> Vec<Block> {
        let piece = Piece { length_m: 60.0, curvature_per_m: 0.0, end_curvature_per_m: None };
        let road = Road::new([0.0, 0.0], 0.0, &[piece]);
        let (offset_m, to_offset_m, gap_m) = (0.0, None, Some(gap_m));
        let mut blocks = Vec::new();
        let closure = Closure { kind, from_m, to_m, offset_m, to_offset_m, gap_m };
        close(&closure, &road, &mut blocks);
        blocks
    }

    #[test]
    fn a_closure_ends_with_the_last_element_that_fits() {
        let end = |blocks: &[Block]| {
            blocks.iter().flat_map(|block| block.foot).fold(0.0, |end: f64, [_, y]| end.max(y))
        };
        // Elements of 3 m, 1 m apart, half a gap at both ends.
        for (to_m, count, end_m) in [(24.0, 6, 23.5), (23.5, 6, 23.5), (23.4, 5, 19.5)] {
            let blocks = row(ClosureKind::Concrete, 0.0, to_m, 1.0);
            assert_eq!((blocks.len(), end(&blocks)), (count, end_m), "{to_m}");
        }
        assert_eq!(row(ClosureKind::Concrete, 10.0, 12.0, 1.0).len(), 0);
        assert_eq!(row(ClosureKind::Water, 10.0, 13.0, 0.0).len(), 2);
    }

    #[test]
    fn no_element_stands_beyond_the_end_of_the_road() {
        for kind in [ClosureKind::Water, ClosureKind::Concrete, ClosureKind::Cone] {
            for to_m in [57.0, 58.5, 60.0, 60.2] {
                for block in row(kind, 20.0, to_m, 4.0) {
                    let length = block.foot[2][1] - block.foot[1][1];
                    assert!(length > 0.05 && block.foot[2][1] <= 60.0, "{kind:?} to {to_m}");
                }
            }
        }
    }
}
