//! A network that is ready to run, on memory of its own.

use crate::isa::{Isa, with_lanes};
use crate::pack::QuantParams;
use crate::step::{Arena, Place, Step, run};

/// Height, width and channels of an activation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Values of a pixel.
    pub channels: usize,
}

impl Shape {
    pub(crate) fn pixels(self) -> usize {
        self.height * self.width
    }
}

/// A network that is ready to run.
#[derive(Clone, Debug)]
pub struct Net {
    pub(crate) isa: Isa,
    pub(crate) steps: Vec<Step>,
    pub(crate) input: Place,
    pub(crate) shape: Shape,
    pub(crate) input_quant: Option<QuantParams>,
    pub(crate) outputs: Vec<(Place, Shape)>,
    pub(crate) arena: Arena,
}

impl Net {
    /// The instruction set that it was put together for.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// Quantisation of the input, `None` for floats.
    pub fn input_quant(&self) -> Option<QuantParams> {
        self.input_quant
    }

    /// Bytes of memory that activations share.
    pub fn memory(&self) -> usize {
        (self.arena.activations.len() + self.arena.scratch.len()) * 64
    }

    fn input_len(&self) -> usize {
        self.shape.pixels() * self.shape.channels
    }

    /// The input to fill before each run, row by row, pixel by pixel, channels last; empty
    /// for a network of floats.
    pub fn input_bytes(&mut self) -> &mut [u8] {
        let len = if self.input_quant.is_some() { self.input_len() } else { 0 };
        let start = self.arena.activations.as_mut_ptr().cast::<u8>();
        // SAFETY: the plan laid the input inside the arena, which is initialised.
        unsafe { std::slice::from_raw_parts_mut(start.add(self.input.offset), len) }
    }

    /// The input of a network of floats; empty for one of bytes.
    pub fn input_floats(&mut self) -> &mut [f32] {
        let len = if self.input_quant.is_none() { self.input_len() } else { 0 };
        let start = self.arena.activations.as_mut_ptr().cast::<u8>();
        // SAFETY: as above; offsets are multiples of 64.
        unsafe { std::slice::from_raw_parts_mut(start.add(self.input.offset).cast(), len) }
    }

    /// Runs the network on its input, which it may overwrite.
    pub fn run(&mut self) {
        for step in &self.steps {
            let arena = &mut self.arena;
            // SAFETY: `finish` planned the steps for this arena, and `Builder::new` checked
            // that the processor has the instructions.
            unsafe { with_lanes!(self.isa, run(step, arena)) }
        }
    }

    /// As [`Self::run`], telling after each step its kind and the time it took.
    pub fn run_timed(&mut self, mut told: impl FnMut(&'static str, std::time::Duration)) {
        for step in &self.steps {
            let arena = &mut self.arena;
            let begun = std::time::Instant::now();
            // SAFETY: as in `run`.
            unsafe { with_lanes!(self.isa, run(step, arena)) }
            told(step.op.name(), begun.elapsed());
        }
    }

    /// Output `index`: pixels with their channels.
    pub fn output(&self, index: usize) -> impl Iterator<Item = &[f32]> {
        let (place, shape) = self.outputs[index];
        let start = self.arena.activations.as_ptr().cast::<u8>();
        (0..shape.pixels()).map(move |i| {
            // SAFETY: the plan laid the output inside the arena, and nothing over it.
            unsafe {
                let pixel = start.add(place.offset + i * place.stride).cast();
                std::slice::from_raw_parts(pixel, shape.channels)
            }
        })
    }
}
