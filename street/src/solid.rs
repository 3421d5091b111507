//! Upright blocks along the road: barriers and hedges, cut into short pieces.
//!
//! Owns their geometry, shared by the picture and the outlines. Owns no colours.

use nalgebra::Point3;

use crate::simulation::Simulation;

/// Length of a piece, m: short enough to sort by distance among vehicles.
const PIECE_M: f64 = 4.0;

/// One piece of a barrier.
#[derive(Debug, Clone)]
pub struct Block {
    /// Foot of the corners, world (X, Y) m, around the piece.
    pub foot: [[f64; 2]; 4],
    /// Middle of the foot, m.
    pub middle: [f64; 2],
    /// Height, m.
    pub height_m: f64,
    /// A hedge and not concrete.
    pub hedge: bool,
}

impl Block {
    /// The eight corners, feet first.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        let at = |i: usize, z: f64| Point3::new(self.foot[i][0], self.foot[i][1], z);
        let h = self.height_m;
        [at(0, 0.0), at(1, 0.0), at(2, 0.0), at(3, 0.0), at(0, h), at(1, h), at(2, h), at(3, h)]
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
            blocks.push(Block { foot, middle, height_m: barrier.height_m, hedge: barrier.hedge });
        }
    }
    blocks
}
