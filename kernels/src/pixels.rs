//! Activations in memory, rows of pixels with channels last, and windows that move over them.

/// Pixels of `channels` bytes (or floats) each, `stride` apart.
#[derive(Clone, Copy)]
pub(crate) struct Pixels<T> {
    pub start: *mut T,
    pub stride: usize,
}

impl<T> Pixels<T> {
    /// From pixel `count` on.
    ///
    /// # Safety
    /// There are as many.
    #[inline(always)]
    pub(crate) unsafe fn skip(self, count: usize) -> Self {
        // SAFETY: guaranteed by the caller.
        Self { start: unsafe { self.start.add(count * self.stride) }, ..self }
    }
}

/// Shape of a convolution's window and of what it moves over.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    pub kernel: usize,
    pub stride: usize,
    pub pad: usize,
    /// Height and width of the input.
    pub from: [usize; 2],
    /// Height and width of the output.
    pub to: [usize; 2],
}

impl Window {
    /// The input row under row `k` of the window for output row `y`, if it is inside.
    #[inline(always)]
    pub(crate) fn row(&self, y: usize, k: usize) -> Option<usize> {
        (y * self.stride + k).checked_sub(self.pad).filter(|&row| row < self.from[0])
    }
}

/// Copies the windows of output row `y` into rows of `scratch`, `width` values each; places
/// outside hold `outside`.
///
/// # Safety
/// `from` holds the input; `scratch` holds `to[1] * width` values.
#[inline(always)]
pub(crate) unsafe fn windows<T: Copy>(
    window: &Window,
    from: Pixels<T>,
    channels: usize,
    y: usize,
    scratch: *mut T,
    width: usize,
    outside: T,
) {
    let run = window.kernel * channels;
    for k in 0..window.kernel {
        let row = window.row(y, k);
        for x in 0..window.to[1] {
            // SAFETY: a window's row has `run` values, all rows together at most `width`.
            unsafe {
                let place = scratch.add(x * width + k * run);
                let left = (x * window.stride).cast_signed() - window.pad.cast_signed();
                let first = left.cast_unsigned();
                let whole = left >= 0 && first + window.kernel <= window.from[1];
                if let (Some(row), true) = (row, whole && from.stride == channels) {
                    let pixel = row * window.from[1] + first;
                    std::ptr::copy_nonoverlapping(from.start.add(pixel * channels), place, run);
                    continue;
                }
                for i in 0..window.kernel {
                    let column = left + i.cast_signed();
                    let inside = column >= 0 && column.cast_unsigned() < window.from[1];
                    for c in 0..channels {
                        let value = match row {
                            Some(row) if inside => {
                                let pixel = row * window.from[1] + column.cast_unsigned();
                                *from.start.add(pixel * from.stride + c)
                            }
                            _ => outside,
                        };
                        *place.add(i * channels + c) = value;
                    }
                }
            }
        }
    }
}
