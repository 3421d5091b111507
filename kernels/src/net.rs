//! A network that is ready to run, on memory of its own.

use crate::isa::Isa;
use crate::op::{Arena, Place, Step};
use crate::pack::QuantParams;
use crate::step::run_on;
use std::sync::Arc;

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

/// An input or output: where it lies and what it is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Port {
    pub place: Place,
    pub shape: Shape,
    pub quant: Option<QuantParams>,
}

impl Port {
    fn len(&self) -> usize {
        self.shape.pixels() * self.shape.channels
    }
}

/// The steps of a network with its weights: what all that run it share.
#[derive(Debug)]
pub(crate) struct Program {
    pub isa: Isa,
    pub steps: Vec<Step>,
    pub inputs: Vec<Port>,
    pub outputs: Vec<Port>,
    /// Bytes of the arena.
    pub activations: usize,
    pub scratch: usize,
}

/// A network that is laid out, with its weights but without memory to run in. A clone shares the
/// weights.
#[derive(Clone)]
pub struct Plan(Arc<Program>);

/// Without weights.
impl std::fmt::Debug for Plan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let steps: Vec<_> = self.0.steps.iter().map(|step| step.op.name()).collect();
        f.debug_struct("Plan").field("isa", &self.0.isa).field("steps", &steps).finish()
    }
}

impl Plan {
    pub(crate) fn new(program: Program) -> Self {
        Self(Arc::new(program))
    }

    /// The network on memory of its own.
    pub fn net(&self) -> Net {
        let arena = Arena::new(self.0.activations, self.0.scratch);
        Net { program: self.0.clone(), arena }
    }

    /// The instruction set that it was put together for.
    pub fn isa(&self) -> Isa {
        self.0.isa
    }

    /// Shapes of its inputs, and their quantisation; `None` for floats.
    pub fn inputs(&self) -> impl Iterator<Item = (Shape, Option<QuantParams>)> {
        self.0.inputs.iter().map(|port| (port.shape, port.quant))
    }
}

/// A network that is ready to run. A clone shares the weights and has memory of its own.
#[derive(Clone)]
pub struct Net {
    program: Arc<Program>,
    arena: Arena,
}

/// Without weights and pixels.
impl std::fmt::Debug for Net {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Net").field(&Plan(self.program.clone())).finish()
    }
}

impl Net {
    /// The instruction set that it was put together for.
    pub fn isa(&self) -> Isa {
        self.program.isa
    }

    /// Shape of input `index`, and its quantisation; `None` for floats.
    pub fn input_fact(&self, index: usize) -> (Shape, Option<QuantParams>) {
        let Port { shape, quant, .. } = self.program.inputs[index];
        (shape, quant)
    }

    /// Shape of output `index`, and its quantisation; `None` for floats.
    pub fn output_fact(&self, index: usize) -> (Shape, Option<QuantParams>) {
        let Port { shape, quant, .. } = self.program.outputs[index];
        (shape, quant)
    }

    /// Bytes of memory that activations share.
    pub fn memory(&self) -> usize {
        (self.arena.activations.len() + self.arena.scratch.len()) * 64
    }

    /// Input `index` to fill before each run, row by row, pixel by pixel, channels last; empty
    /// for an input of floats.
    pub fn input_bytes(&mut self, index: usize) -> &mut [u8] {
        let port = self.program.inputs[index];
        let len = if port.quant.is_some() { port.len() } else { 0 };
        let start = self.arena.activations.as_mut_ptr().cast::<u8>();
        debug_assert!(port.place.offset + len <= self.arena.activations.len() * 64);
        // SAFETY: the plan laid the input inside the arena, which is initialised.
        unsafe { std::slice::from_raw_parts_mut(start.add(port.place.offset), len) }
    }

    /// As [`Self::input_bytes`] for an input of floats; empty for one of bytes.
    pub fn input_floats(&mut self, index: usize) -> &mut [f32] {
        let port = self.program.inputs[index];
        let len = if port.quant.is_none() { port.len() } else { 0 };
        let start = self.arena.activations.as_mut_ptr().cast::<u8>();
        debug_assert!(port.place.offset + 4 * len <= self.arena.activations.len() * 64);
        // SAFETY: as above; offsets are multiples of 64.
        unsafe { std::slice::from_raw_parts_mut(start.add(port.place.offset).cast(), len) }
    }

    /// Runs the network on its inputs, which it may overwrite.
    pub fn run(&mut self) {
        for step in &self.program.steps {
            // SAFETY: `finish` planned the steps for this arena, and `Builder::new` checked
            // that the processor has the instructions.
            unsafe { run_on(self.program.isa, step, &mut self.arena) }
        }
    }

    /// As [`Self::run`], telling after each step its kind and the time it took.
    pub fn run_timed(&mut self, mut told: impl FnMut(&'static str, std::time::Duration)) {
        for step in &self.program.steps {
            let begun = std::time::Instant::now();
            // SAFETY: as in `run`.
            unsafe { run_on(self.program.isa, step, &mut self.arena) }
            told(step.op.name(), begun.elapsed());
        }
    }

    /// Output `index`, pixels with their channels; none for an output of bytes.
    pub fn output(&self, index: usize) -> impl Iterator<Item = &[f32]> {
        self.pixels::<f32>(index, self.program.outputs[index].quant.is_none())
    }

    /// As [`Self::output`] for an output of bytes; none for one of floats.
    pub fn output_bytes(&self, index: usize) -> impl Iterator<Item = &[u8]> {
        self.pixels::<u8>(index, self.program.outputs[index].quant.is_some())
    }

    /// `T` is what the output is stored in where `is_it`.
    fn pixels<T: 'static>(&self, index: usize, is_it: bool) -> impl Iterator<Item = &[T]> {
        let Port { place, shape, .. } = self.program.outputs[index];
        let start = self.arena.activations.as_ptr().cast::<u8>();
        let count = if is_it { shape.pixels() } else { 0 };
        debug_assert!(
            place.offset + count.saturating_sub(1) * place.stride + shape.channels * size_of::<T>()
                <= self.arena.activations.len() * 64
                || count == 0
        );
        (0..count).map(move |i| {
            // SAFETY: the plan laid the output inside the arena, and nothing over it.
            unsafe {
                let pixel = start.add(place.offset + i * place.stride).cast();
                std::slice::from_raw_parts(pixel, shape.channels)
            }
        })
    }
}
