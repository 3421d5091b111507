//! Whether a picture can be measured at all: blank, blinded, blurred, unchanged; day or night.
//!
//! Owns what is read from the luma of one picture and from two in a row. Reads no clock and
//! allocates nothing; what follows from a flaw is decided in [`crate::health`]. The picture
//! is given on the working grid (see [`crate::scene::Grid`]). Measured figures behind the
//! thresholds: docs/measured/health.md.

use core::fmt;

/// A picture whose levels (1st to 99th percentile) span less is blank: black, or the
/// one colour of a converter without a signal. The darkest usable night spans 40.
pub const BLANK_SPAN: u8 = 16;
/// Share of cells at the top of the scale from which the camera is blinded.
pub const BLINDED_SHARE: f32 = 0.35;
/// Level from which a cell is at the top of the scale.
const BRIGHT: usize = 248;
/// A picture whose levels (5th to 95th percentile) span less shows no contrast: fog, sun in the
/// lens, a dirty dome.
pub const LEAST_CONTRAST: u8 = 24;
/// Steepest edges (the 99th percentile of gradients) as a share of the contrast: below it nothing
/// in the picture is sharp.
pub const LEAST_SHARPNESS: f32 = 0.15;
/// Mean level below which it is night.
pub const NIGHT_MEAN: f32 = 80.0;
/// Blocks in which two pictures are compared, to each side.
const SIDE: usize = 8;
/// Mean difference of a block, levels, below which it has not changed. Re-encoding a frozen
/// picture gives 0; the noise of a camera at the quietest 0.6 and more.
pub const STILL_LEVELS: f32 = 0.35;
/// Blocks that may change in a picture that has not: a running clock touches up to four.
pub const CLOCK_BLOCKS: usize = 6;

/// A flaw that makes a picture useless.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flaw {
    /// Black, or all of one level.
    Blank,
    /// Sun, headlights or fog: no contrast.
    Blinded,
    /// Out of focus, dirt or water on the dome.
    Blurred,
}

impl Flaw {
    /// The flaw in a word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Blank => "blank",
            Self::Blinded => "blinded",
            Self::Blurred => "blurred",
        }
    }
}

impl fmt::Display for Flaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The light in which a frame was taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Light {
    /// Daylight.
    #[default]
    Day,
    /// Street light or headlights.
    Night,
}

impl Light {
    /// That of a picture with this mean level (0 to 255).
    pub fn of_mean(mean: f32) -> Self {
        if mean < NIGHT_MEAN { Self::Night } else { Self::Day }
    }
}

/// Features of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Mean level, 0 to 255.
    pub mean: f32,
    /// Levels at the 1st and 99th percentile.
    pub span: u8,
    /// Levels at the 5th and 95th percentile.
    pub contrast: u8,
    /// Share of cells at the top of the scale.
    pub bright: f32,
    /// The 99th part of gradients, as a share of the contrast for each cell.
    pub sharpness: f32,
}

impl Look {
    /// Reads a luma picture of that width.
    pub fn at(luma: &[u8], width: usize) -> Self {
        let mut levels = [0u32; 256];
        let mut gradients = [0u32; 256];
        let (mut sum, mut steps) = (0u64, 0u32);
        for &level in luma {
            sum += u64::from(level);
            if let Some(count) = levels.get_mut(usize::from(level)) {
                *count += 1;
            }
        }
        if width > 0 {
            // Not zipped chunks, whose length the compiler divides for: a panic path to it.
            let row = |y: usize| luma.get(y * width..(y + 1) * width);
            for y in 0.. {
                let (Some(row), Some(below)) = (row(y), row(y + 1)) else { break };
                for (pair, &under) in row.windows(2).zip(below) {
                    let &[here, right] = pair else { continue };
                    let step = here.abs_diff(right).max(here.abs_diff(under));
                    steps += 1;
                    if let Some(count) = gradients.get_mut(usize::from(step)) {
                        *count += 1;
                    }
                }
            }
        }
        let cells = luma.len() as u32;
        let part = |counts: &[u32; 256], of: u32, part: f32| {
            let wanted = of as f32 * part;
            let mut below = 0;
            let at = counts.iter().position(|count| {
                below += count;
                below as f32 > wanted
            });
            at.unwrap_or(255) as u8
        };
        let between =
            |low, high| part(&levels, cells, high).saturating_sub(part(&levels, cells, low));
        let contrast = between(0.05, 0.95);
        let bright: u32 = levels.iter().skip(BRIGHT).sum();
        let all = if cells == 0 { 1.0 } else { cells as f32 };
        Self {
            mean: sum as f32 / all,
            span: between(0.01, 0.99),
            contrast,
            bright: bright as f32 / all,
            sharpness: f32::from(part(&gradients, steps, 0.99)) / f32::from(contrast.max(1)),
        }
    }

    /// The flaw that makes the picture useless, if it has one.
    pub fn flaw(&self) -> Option<Flaw> {
        if self.span < BLANK_SPAN {
            Some(Flaw::Blank)
        } else if self.bright > BLINDED_SHARE || self.contrast < LEAST_CONTRAST {
            Some(Flaw::Blinded)
        } else if self.sharpness < LEAST_SHARPNESS {
            Some(Flaw::Blurred)
        } else {
            None
        }
    }

    /// Whether it is night (or as dark as night).
    pub fn is_night(&self) -> bool {
        self.mean < NIGHT_MEAN
    }
}

/// The picture before, to tell one that has not changed. `L` is a buffer for one picture.
#[derive(Debug)]
pub struct Before<L> {
    luma: L,
    known: bool,
}

impl<L: AsRef<[u8]> + AsMut<[u8]>> Before<L> {
    /// No picture yet.
    pub const fn new(luma: L) -> Self {
        Self { luma, known: false }
    }

    /// Whether `luma`, a picture of that width, shows nothing new but a clock. A picture that
    /// does is kept as the one to compare the next with; one that does not is not, so that
    /// slow changes add up.
    pub fn repeats(&mut self, luma: &[u8], width: usize) -> bool {
        let before = self.luma.as_mut();
        let same_size = before.len() == luma.len();
        let repeats =
            self.known && same_size && changed_blocks(before, luma, width) <= CLOCK_BLOCKS;
        if !repeats && same_size {
            before.copy_from_slice(luma);
            self.known = true;
        }
        repeats
    }
}

/// Number of blocks, of 64, that differ.
pub fn changed_blocks(before: &[u8], luma: &[u8], width: usize) -> usize {
    let height = luma.len().checked_div(width).unwrap_or(0);
    let mut sums = [[0u32; SIDE]; SIDE];
    let mut counts = [[0u32; SIDE]; SIDE];
    if width == 0 {
        return 0;
    }
    for (y, (a, b)) in before.chunks_exact(width).zip(luma.chunks_exact(width)).enumerate() {
        let row = (y * SIDE).checked_div(height).unwrap_or(0);
        let (Some(sums), Some(counts)) = (sums.get_mut(row), counts.get_mut(row)) else { continue };
        for (x, (a, b)) in a.iter().zip(b).enumerate() {
            let column = (x * SIDE).checked_div(width).unwrap_or(0);
            if let (Some(sum), Some(count)) = (sums.get_mut(column), counts.get_mut(column)) {
                *sum += u32::from(a.abs_diff(*b));
                *count += 1;
            }
        }
    }
    let cells = sums.as_flattened().iter().zip(counts.as_flattened());
    cells.filter(|&(&sum, &count)| sum as f32 > STILL_LEVELS * count as f32).count()
}
