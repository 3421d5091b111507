//! The frame header: a picture's size, and what of each component is kept while it is read.

use super::super::check_size;
use super::{DecodeError, damaged};

/// One component of the frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Component {
    pub id: u8,
    pub h: usize,
    pub v: usize,
    pub quantiser: usize,
    /// Blocks in a row and rows of blocks, in scans of this component alone and as allocated.
    pub blocks: (usize, usize),
    pub stride: usize,
    /// Progressive: which coefficients of each block are not zero.
    pub nonzero: Vec<u64>,
    /// The lowest bit that was sent of each coefficient so far; 255: none.
    pub sent: Vec<u8>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Frame {
    pub width: usize,
    pub height: usize,
    pub progressive: bool,
    pub h: usize,
    pub v: usize,
    pub components: Vec<Component>,
}

impl Frame {
    pub fn read(body: &[u8], progressive: bool) -> Result<Self, DecodeError> {
        let wrong = || damaged("a frame header that is none");
        let &[precision, h1, h0, w1, w0, count, ref rest @ ..] = body else { return Err(wrong()) };
        if precision != 8 {
            return Err(damaged("a JPEG of more than 8 bits: set the camera to baseline"));
        }
        let height = usize::from(u16::from_be_bytes([h1, h0]));
        let width = usize::from(u16::from_be_bytes([w1, w0]));
        let specifications = rest.get(..3 * usize::from(count)).ok_or_else(wrong)?;
        let mut frame = Self { width, height, progressive, h: 1, v: 1, components: Vec::new() };
        for specification in specifications.chunks_exact(3) {
            let (h, v) = (usize::from(specification[1] >> 4), usize::from(specification[1] & 15));
            if !(1..=4).contains(&h) || !(1..=4).contains(&v) {
                return Err(wrong());
            }
            (frame.h, frame.v) = (frame.h.max(h), frame.v.max(v));
            let (id, quantiser) = (specification[0], usize::from(specification[2]));
            frame.components.push(Component { id, h, v, quantiser, ..Component::default() });
        }
        if !(1..=4).contains(&frame.components.len()) || width == 0 || height == 0 {
            return Err(damaged(&format!("it has {width}x{height} px in {count} components")));
        }
        check_size(width as u32, height as u32)?;
        for component in &mut frame.components {
            let blocks =
                |size: usize, own: usize, most: usize| (size * own).div_ceil(most).div_ceil(8);
            component.blocks =
                (blocks(width, component.h, frame.h), blocks(height, component.v, frame.v));
            component.stride = width.div_ceil(8 * frame.h) * component.h;
            component.sent = vec![255; 64];
            if progressive {
                let rows = height.div_ceil(8 * frame.v) * component.v;
                component.nonzero = vec![0; component.stride * rows];
            }
        }
        Ok(frame)
    }
}
