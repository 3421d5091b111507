//! Preconditions of the unsafe code, checked before each step where assertions are on.
//!
//! Owns how far an operation reads and writes. The plan (`builder`, `layout`) promises that all
//! of it lies inside the arena and that no output lies over an input; a plan that broke its
//! promise would otherwise show as a wrong pixel, or not at all.

use crate::op::{Arena, Op, Place, Step};
use crate::pack::Packed;

/// Pixels, and bytes of each.
#[derive(Clone, Copy, Debug)]
struct Extent {
    pixels: usize,
    bytes: usize,
}

impl Extent {
    fn end(self, place: Place) -> usize {
        place.offset + self.pixels.saturating_sub(1) * place.stride + self.bytes
    }
}

/// Bytes that an operation reads of each input, writes, and needs as scratch memory.
struct Reach {
    from: Extent,
    to: Extent,
    scratch: usize,
}

/// Bytes of a stored pixel of a convolution of bytes.
fn stored(packed: &Packed) -> usize {
    packed.channels * if packed.finish.zero.is_some() { 1 } else { 4 }
}

fn reach(op: &Op, lanes: usize) -> Reach {
    let same = |pixels, bytes| Reach {
        from: Extent { pixels, bytes },
        to: Extent { pixels, bytes },
        scratch: 0,
    };
    let area = |[height, width]: [usize; 2]| height * width;
    match op {
        Op::Product { packed, count } => Reach {
            from: Extent { pixels: *count, bytes: 4 * packed.fours },
            to: Extent { pixels: *count, bytes: stored(packed) },
            scratch: 0,
        },
        Op::ProductF { packed, count } => Reach {
            from: Extent { pixels: *count, bytes: 4 * packed.inputs },
            to: Extent { pixels: *count, bytes: 4 * packed.channels },
            scratch: 0,
        },
        Op::Dense { packed, window, channels, .. } => Reach {
            from: Extent { pixels: area(window.from), bytes: *channels },
            to: Extent { pixels: area(window.to), bytes: stored(packed) },
            scratch: window.to[1] * 4 * packed.fours,
        },
        Op::DenseF { packed, window, channels } => Reach {
            from: Extent { pixels: area(window.from), bytes: 4 * channels },
            to: Extent { pixels: area(window.to), bytes: 4 * packed.channels },
            scratch: window.to[1] * 4 * packed.inputs,
        },
        Op::Depthwise { packed, window, .. } => {
            let padded = packed.channels.next_multiple_of(lanes);
            let columns = window.from[1] + 2 * window.pad;
            Reach {
                from: Extent { pixels: area(window.from), bytes: packed.channels },
                to: Extent { pixels: area(window.to), bytes: stored(packed) },
                scratch: columns * window.kernel.div_ceil(4) * 4 * padded,
            }
        }
        Op::DepthwiseF { packed, window } => Reach {
            // Whole vectors are read.
            from: Extent {
                pixels: area(window.from),
                bytes: 4 * packed.channels.next_multiple_of(lanes),
            },
            to: Extent { pixels: area(window.to), bytes: 4 * packed.channels },
            scratch: 0,
        },
        Op::Pool { window, channels } => Reach {
            from: Extent { pixels: area(window.from), bytes: *channels },
            to: Extent { pixels: area(window.to), bytes: *channels },
            scratch: 0,
        },
        Op::PoolF { window, channels } => Reach {
            from: Extent { pixels: area(window.from), bytes: 4 * channels },
            to: Extent { pixels: area(window.to), bytes: 4 * channels },
            scratch: 0,
        },
        Op::Interleave { channels, count } => Reach {
            from: Extent { pixels: *count, bytes: *channels },
            to: Extent { pixels: *count, bytes: 2 * channels },
            scratch: 0,
        },
        Op::InterleaveF { channels, count } => Reach {
            from: Extent { pixels: *count, bytes: 4 * channels },
            to: Extent { pixels: *count, bytes: 8 * channels },
            scratch: 0,
        },
        Op::Copy { bytes, count } => same(*count, *bytes),
        Op::Rescale { channels, count, .. } | Op::Add { channels, count, .. } => {
            same(*count, *channels)
        }
        Op::AddF { channels, count } => same(*count, 4 * channels),
        Op::Double { size, channels } => Reach {
            from: Extent { pixels: area(*size), bytes: *channels },
            to: Extent { pixels: 4 * area(*size), bytes: *channels },
            scratch: 0,
        },
        Op::DoubleF { size, channels } => Reach {
            from: Extent { pixels: area(*size), bytes: 4 * channels },
            to: Extent { pixels: 4 * area(*size), bytes: 4 * channels },
            scratch: 0,
        },
    }
}

/// Panics unless all that `step` touches with vectors of `lanes` lies inside `arena`, and what
/// it writes apart from what it reads.
pub(crate) fn check(step: &Step, arena: &Arena, lanes: usize) {
    let Reach { from, to, scratch } = reach(&step.op, lanes);
    let bytes = arena.activations.len() * 64;
    let name = step.op.name();
    for place in step.from {
        let end = from.end(place);
        assert!(end <= bytes, "{name} reads {end} of {bytes} bytes");
        let apart = to.end(step.to) <= place.offset
            || end <= step.to.offset
            // Other channels of the same pixels.
            || step.to.stride == place.stride;
        assert!(apart, "{name} writes at {:?} over its input at {place:?}", step.to);
    }
    let end = to.end(step.to);
    assert!(end <= bytes, "{name} writes {end} of {bytes} bytes");
    let room = arena.scratch.len() * 64;
    assert!(scratch <= room, "{name} needs {scratch} of {room} bytes of scratch");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn copy(from: usize, to: usize) -> Step {
        let place = |offset| Place { offset, stride: 16 };
        let op = Op::Copy { bytes: 16, count: 8 };
        Step { op, from: [place(from); 2], to: Place { stride: 32, ..place(to) } }
    }

    #[test]
    fn a_plan_that_keeps_its_promise_passes() {
        check(&copy(0, 128), &Arena::new(512, 0), 8);
    }

    #[test]
    #[should_panic(expected = "writes 752 of 640 bytes")]
    fn an_output_beyond_the_arena_is_caught() {
        check(&copy(0, 512), &Arena::new(512, 0), 8);
    }

    #[test]
    #[should_panic(expected = "over its input")]
    fn an_output_over_an_input_is_caught() {
        check(&copy(64, 128), &Arena::new(512, 0), 8);
    }
}
