//! From a camera's raw pixels to RGB: YUYV, NV12 and GREY.
//!
//! Owns the layouts of these formats (Linux kernel, "Image Formats": a picture is rows of
//! `stride` bytes, which may be padded) and the matrices of BT.601 and BT.709. Knows no
//! device.

use super::DecodeError;
use crate::daemon::frame::Picture;

/// How luma and chroma became bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Colour {
    /// BT.601 with luma 16 to 235: what cameras send that say nothing.
    #[default]
    Bt601,
    /// BT.601 with luma 0 to 255, as in JPEG.
    Bt601Full,
    /// BT.709 with luma 16 to 235: HDMI sources.
    Bt709,
    /// BT.709 with luma 0 to 255: what many cameras stream.
    Bt709Full,
}

/// Fixed-point factors: 1 is 1024, so that the sum of a pixel fits in 20 bits and a sign.
struct Matrix {
    luma_zero: i32,
    luma: i32,
    red_v: i32,
    green_u: i32,
    green_v: i32,
    blue_u: i32,
}

impl Colour {
    /// ITU-R BT.601-7 and BT.709-6, section 3 (inverse), times 255/219 and 255/224 where
    /// the range is 16 to 235.
    const fn matrix(self) -> Matrix {
        match self {
            Self::Bt601 => Matrix {
                luma_zero: 16,
                luma: 1192,
                red_v: 1634,
                green_u: 401,
                green_v: 832,
                blue_u: 2066,
            },
            Self::Bt601Full => Matrix {
                luma_zero: 0,
                luma: 1024,
                red_v: 1436,
                green_u: 352,
                green_v: 731,
                blue_u: 1815,
            },
            Self::Bt709 => Matrix {
                luma_zero: 16,
                luma: 1192,
                red_v: 1836,
                green_u: 218,
                green_v: 546,
                blue_u: 2163,
            },
            Self::Bt709Full => Matrix {
                luma_zero: 0,
                luma: 1024,
                red_v: 1613,
                green_u: 192,
                green_v: 479,
                blue_u: 1900,
            },
        }
    }
}

impl Matrix {
    fn rgb(&self, y: u8, u: u8, v: u8) -> [u8; 3] {
        let luma = (i32::from(y) - self.luma_zero) * self.luma + 512;
        let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
        let byte = |sum: i32| (sum >> 10).clamp(0, 255) as u8;
        [
            byte(luma + self.red_v * v),
            byte(luma - self.green_u * u - self.green_v * v),
            byte(luma + self.blue_u * u),
        ]
    }
}

/// Where the rows of a picture lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Bytes from one row to the next.
    pub stride: usize,
}

impl Layout {
    /// `rows` rows of `row` bytes each out of `bytes`, or how many bytes there should be.
    /// The last row may end without its padding.
    fn rows<'a>(
        &self,
        bytes: &'a [u8],
        row: usize,
        rows: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]>, DecodeError> {
        let stride = self.stride.max(row);
        let expected = stride * rows.saturating_sub(1) + row;
        if bytes.len() < expected || row == 0 || rows == 0 {
            return Err(DecodeError::Short { expected, actual: bytes.len() });
        }
        Ok(bytes.chunks(stride).take(rows).map(move |chunk| &chunk[..row]))
    }

    fn prepare(&self, picture: &mut Picture) {
        (picture.width, picture.height) = (self.width, self.height);
        picture.rgb.resize(self.width * self.height * 3, 0);
    }
}

/// YUYV 4:2:2: two pixels in four bytes, `Y0 U Y1 V`.
///
/// # Errors
/// [`DecodeError::Short`] where `bytes` end before the picture does.
pub fn yuyv(
    bytes: &[u8],
    layout: Layout,
    colour: Colour,
    picture: &mut Picture,
) -> Result<(), DecodeError> {
    let matrix = colour.matrix();
    let rows = layout.rows(bytes, layout.width.next_multiple_of(2) * 2, layout.height)?;
    layout.prepare(picture);
    for (row, out) in rows.zip(picture.rgb.chunks_exact_mut(layout.width * 3)) {
        for (pair, out) in row.chunks_exact(4).zip(out.chunks_mut(6)) {
            let (first, second) = out.split_at_mut(3);
            first.copy_from_slice(&matrix.rgb(pair[0], pair[1], pair[3]));
            if !second.is_empty() {
                second.copy_from_slice(&matrix.rgb(pair[2], pair[1], pair[3]));
            }
        }
    }
    Ok(())
}

/// NV12 4:2:0: all luma rows, then half as many rows of `U V`, one pair for 2x2 pixels.
///
/// # Errors
/// [`DecodeError::Short`] where `bytes` end before the picture does.
pub fn nv12(
    bytes: &[u8],
    layout: Layout,
    colour: Colour,
    picture: &mut Picture,
) -> Result<(), DecodeError> {
    let matrix = colour.matrix();
    let stride = layout.stride.max(layout.width);
    let chroma_row = layout.width.next_multiple_of(2);
    let chroma_rows = layout.height.div_ceil(2);
    let luma_len = stride * layout.height;
    let expected = luma_len + stride * chroma_rows.saturating_sub(1) + chroma_row;
    let short = DecodeError::Short { expected, actual: bytes.len() };
    let (luma, chroma) = bytes.split_at_checked(luma_len).ok_or(short)?;
    let luma = layout.rows(luma, layout.width, layout.height)?;
    if chroma.len() < expected - luma_len {
        return Err(DecodeError::Short { expected, actual: bytes.len() });
    }
    layout.prepare(picture);
    let rows = luma.zip(picture.rgb.chunks_exact_mut(layout.width * 3));
    for (index, (luma, out)) in rows.enumerate() {
        let chroma = &chroma[index / 2 * stride..][..chroma_row];
        for (x, (&y, out)) in luma.iter().zip(out.chunks_exact_mut(3)).enumerate() {
            let pair = x & !1;
            out.copy_from_slice(&matrix.rgb(y, chroma[pair], chroma[pair + 1]));
        }
    }
    Ok(())
}

/// A picture in three planes, as decoders give it: luma, and blue and red chroma with one sample
/// for `across` by `down` pixels.
#[derive(Clone, Copy, Debug)]
pub struct Planes<'a> {
    /// Luma, `width * height`.
    pub luma: &'a [u8],
    /// Blue chroma (U, Cb).
    pub blue: &'a [u8],
    /// Red chroma (V, Cr).
    pub red: &'a [u8],
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Columns of pixels that share a sample of chroma.
    pub across: usize,
    /// Rows of pixels that do.
    pub down: usize,
}

/// Three planes.
///
/// # Errors
/// [`DecodeError::Short`] where a plane ends before the picture does.
pub fn planes(
    planes: &Planes<'_>,
    colour: Colour,
    picture: &mut Picture,
) -> Result<(), DecodeError> {
    let Planes { luma, blue, red, width, height, across, down } = *planes;
    let chroma_row = width.div_ceil(across);
    let chroma_len = chroma_row * height.div_ceil(down);
    let expected = width * height + 2 * chroma_len;
    let is_whole = luma.len() >= width * height && blue.len().min(red.len()) >= chroma_len;
    if !is_whole || width == 0 || height == 0 {
        let actual = luma.len() + blue.len() + red.len();
        return Err(DecodeError::Short { expected, actual });
    }
    let matrix = colour.matrix();
    Layout { width, height, stride: width }.prepare(picture);
    let rows = luma.chunks_exact(width).zip(picture.rgb.chunks_exact_mut(width * 3));
    for (index, (luma, out)) in rows.enumerate() {
        let at = index / down * chroma_row;
        let (blue, red) = (&blue[at..at + chroma_row], &red[at..at + chroma_row]);
        for (x, (&y, out)) in luma.iter().zip(out.chunks_exact_mut(3)).enumerate() {
            out.copy_from_slice(&matrix.rgb(y, blue[x / across], red[x / across]));
        }
    }
    Ok(())
}

/// GREY: one byte a pixel. It becomes a grey picture in RGB.
///
/// # Errors
/// [`DecodeError::Short`] where `bytes` end before the picture does.
pub fn grey(bytes: &[u8], layout: Layout, picture: &mut Picture) -> Result<(), DecodeError> {
    let rows = layout.rows(bytes, layout.width, layout.height)?;
    layout.prepare(picture);
    for (row, out) in rows.zip(picture.rgb.chunks_exact_mut(layout.width * 3)) {
        for (&value, out) in row.iter().zip(out.chunks_exact_mut(3)) {
            out.fill(value);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The 75 % bars of SMPTE RP 219 in BT.601, 8 bits, 16 to 235, with their RGB.
    const BARS_601: [([u8; 3], [u8; 3]); 8] = [
        ([180, 128, 128], [191, 191, 191]),
        ([162, 44, 142], [191, 191, 0]),
        ([131, 156, 44], [0, 191, 191]),
        ([112, 72, 58], [0, 191, 0]),
        ([84, 184, 198], [191, 0, 191]),
        ([65, 100, 212], [191, 0, 0]),
        ([35, 212, 114], [0, 0, 191]),
        ([16, 128, 128], [0, 0, 0]),
    ];

    fn near(actual: &[u8], expected: [u8; 3], tolerance: u8) -> bool {
        actual.iter().zip(expected).all(|(&a, e)| a.abs_diff(e) <= tolerance)
    }

    /// One row of bars, two pixels each, with `padding` bytes behind each row.
    fn yuyv_bars(rows: usize, padding: usize) -> Vec<u8> {
        let row: Vec<u8> = BARS_601.iter().flat_map(|&([y, u, v], _)| [y, u, y, v]).collect();
        let row = [row, vec![0xee; padding]].concat();
        row.repeat(rows)
    }

    #[test]
    fn yuyv_bars_have_their_colours_whatever_the_padding() {
        for padding in [0, 32] {
            let layout = Layout { width: 16, height: 3, stride: 32 + padding };
            let mut picture = Picture::default();
            yuyv(&yuyv_bars(3, padding), layout, Colour::Bt601, &mut picture).expect("whole");
            for (n, (pixel, column)) in picture.rgb.chunks(3).zip((0..16).cycle()).enumerate() {
                let expected = BARS_601[column / 2].1;
                assert!(near(pixel, expected, 2), "pixel {n}: {pixel:?}, not {expected:?}");
            }
        }
    }

    #[test]
    fn nv12_bars_have_their_colours_whatever_the_padding() {
        for padding in [0, 48] {
            let (width, height, stride) = (16, 4, 16 + padding);
            let mut bytes = Vec::new();
            for _ in 0..height {
                bytes.extend(BARS_601.iter().flat_map(|&([y, _, _], _)| [y, y]));
                bytes.resize(bytes.len() + padding, 0xee);
            }
            for _ in 0..height / 2 {
                bytes.extend(BARS_601.iter().flat_map(|&([_, u, v], _)| [u, v]));
                bytes.resize(bytes.len() + padding, 0xee);
            }
            let mut picture = Picture::default();
            let layout = Layout { width, height, stride };
            nv12(&bytes, layout, Colour::Bt601, &mut picture).expect("whole");
            for (pixel, column) in picture.rgb.chunks(3).zip((0..16).cycle()) {
                assert!(near(pixel, BARS_601[column / 2].1, 2), "column {column}: {pixel:?}");
            }
        }
    }

    #[test]
    fn each_matrix_gives_white_black_and_its_own_red() {
        for (colour, white, black, red) in [
            (Colour::Bt601, 235, 16, [81, 90, 240]),
            (Colour::Bt601Full, 255, 0, [76, 85, 255]),
            (Colour::Bt709, 235, 16, [63, 102, 240]),
        ] {
            let matrix = colour.matrix();
            assert_eq!(matrix.rgb(white, 128, 128), [255; 3], "{colour:?}");
            assert_eq!(matrix.rgb(black, 128, 128), [0; 3], "{colour:?}");
            let [y, u, v] = red;
            let seen = matrix.rgb(y, u, v);
            assert!(near(&seen, [255, 0, 0], 3), "{colour:?}: {seen:?}");
        }
    }

    #[test]
    fn grey_keeps_each_byte() {
        let mut picture = Picture::default();
        let layout = Layout { width: 2, height: 2, stride: 4 };
        grey(&[0, 128, 9, 9, 255, 7, 9, 9], layout, &mut picture).expect("whole");
        assert_eq!(picture.rgb, [0, 0, 0, 128, 128, 128, 255, 255, 255, 7, 7, 7]);
    }

    #[test]
    fn odd_sizes_and_every_truncation_are_taken_without_a_panic() {
        for (width, height) in [(1, 1), (3, 3), (5, 2), (16, 4)] {
            let layout = Layout { width, height, stride: 0 };
            let even = width + width % 2;
            for (name, whole) in [
                ("yuyv", even * 2 * height),
                ("nv12", width * height + width * (height.div_ceil(2) - 1) + even),
                ("grey", width * height),
            ] {
                for len in 0..=whole {
                    let (bytes, mut picture) = (vec![100; len], Picture::default());
                    let outcome = match name {
                        "yuyv" => yuyv(&bytes, layout, Colour::Bt601, &mut picture),
                        "nv12" => nv12(&bytes, layout, Colour::Bt601, &mut picture),
                        _ => grey(&bytes, layout, &mut picture),
                    };
                    let case = format!("{name} {width}x{height}, {len} of {whole} bytes");
                    assert_eq!(outcome.is_ok(), len == whole, "{case}: {outcome:?}");
                    if outcome.is_ok() {
                        assert_eq!(picture.rgb.len(), width * height * 3, "{case}");
                    }
                }
            }
        }
    }
}
