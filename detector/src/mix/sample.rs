//! The pictures that fill an allocation: drawn without repetition, from a seed.

use super::Cell;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::path::PathBuf;

/// `count` pictures of the cell, sorted. The draw depends on the seed and the cell alone, so
/// that another data set in the mix does not change it.
pub fn draw(cell: &Cell, count: usize, seed: u64) -> Vec<PathBuf> {
    // FNV-1a over the names keys the stream.
    let key = cell
        .set
        .bytes()
        .chain([0])
        .chain(cell.scenario.bytes())
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
        });
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ key);
    let mut pictures = cell.pictures.clone();
    pictures.shuffle(&mut rng);
    pictures.truncate(count);
    pictures.sort();
    pictures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_is_seeded_and_repeats_nothing() {
        let pictures: Vec<PathBuf> = (0..100).map(|i| format!("{i:03}.jpg").into()).collect();
        let cell = Cell { set: "a".into(), scenario: "day".into(), pictures };
        let first = draw(&cell, 30, 1);
        assert_eq!(first, draw(&cell, 30, 1));
        assert_ne!(first, draw(&cell, 30, 2));
        let mut once = first.clone();
        once.dedup();
        assert_eq!((once.len(), first.len()), (30, 30));
        assert_eq!(draw(&cell, 100, 1), cell.pictures);
    }
}
