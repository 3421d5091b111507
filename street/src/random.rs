//! The one source of chance: ChaCha8 streams named by purpose, and stateless hash noise.
//!
//! Owns every random number of the simulator, so that a seed fixes every byte. A stream per
//! purpose keeps traffic the same when only the drawing changes. Owns no scene knowledge.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A named stream of random numbers.
#[derive(Debug, Clone)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream of `seed` for one purpose; streams of different names are independent.
    pub fn new(seed: u64, purpose: &str) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // FNV-1a of the name picks one of the cipher's 2^64 streams.
        let name = purpose.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        rng.set_stream(name);
        Stream(rng)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Normal with the given mean and standard deviation, cut at 2.5 deviations (Box-Muller).
    pub fn normal(&mut self, mean: f64, sd: f64) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        let z = radius * (std::f64::consts::TAU * self.unit()).cos();
        mean + sd * z.clamp(-2.5, 2.5)
    }

    /// Exponential with the given mean.
    pub fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.unit()).ln()
    }

    /// An index drawn by weight; weights are not negative and not all zero.
    pub fn weighted(&mut self, weights: &[f64]) -> usize {
        let mut left = self.unit() * weights.iter().sum::<f64>();
        for (index, weight) in weights.iter().enumerate() {
            left -= weight;
            if left < 0.0 {
                return index;
            }
        }
        weights.iter().rposition(|weight| *weight > 0.0).unwrap_or(0)
    }

    /// 64 random bits, to seed [`hash`] noise.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }
}

/// A well-mixed hash of a 64-bit value (the finaliser of SplitMix64, Steele et al. 2014).
pub fn hash(value: u64) -> u64 {
    let mut x = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Hash noise of a lattice cell, uniform in [0, 1).
pub fn cell(x: i64, y: i64, salt: u64) -> f32 {
    let mixed =
        (x as u64).wrapping_mul(0x8da6_b343) ^ (y as u64).wrapping_mul(0xd816_3841_0000_0001);
    (hash(mixed ^ salt) >> 40) as f32 / (1u32 << 24) as f32
}

/// Value noise with smooth interpolation, mean 0.5, in [0, 1); one cell is one unit.
pub fn smooth(x: f64, y: f64, salt: u64) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let fade = |t: f64| (t * t * (3.0 - 2.0 * t)) as f32;
    let (tx, ty) = (fade(x - x0), fade(y - y0));
    let (i, j) = (x0 as i64, y0 as i64);
    let top = cell(i, j, salt) * (1.0 - tx) + cell(i + 1, j, salt) * tx;
    let bottom = cell(i, j + 1, salt) * (1.0 - tx) + cell(i + 1, j + 1, salt) * tx;
    top * (1.0 - ty) + bottom * ty
}
