//! Putting a network together, laying out its memory, running it.

use crate::conv::Window;
use crate::isa::{Isa, traits, with_lanes};
use crate::moves::Rescale;
use crate::pack::{Conv, Steps, Weights};
use crate::step::{Arena, BEHIND, Place, Step, Work, run};

/// Height, width and channels of a picture.
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
    fn pixels(self) -> usize {
        self.height * self.width
    }
}

/// A picture of the network that is put together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Tensor(usize);

/// What the kernels cannot do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlanError {
    reason: String,
}

impl std::fmt::Display for PlanError {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(&self.reason)
    }
}

impl std::error::Error for PlanError {}

fn refuse<T>(reason: impl Into<String>) -> Result<T, PlanError> {
    Err(PlanError { reason: reason.into() })
}

#[derive(Clone, Debug)]
struct Picture {
    shape: Shape,
    /// `None`: floats.
    steps: Option<Steps>,
    /// Some channels of another picture, from one on.
    part_of: Option<(Tensor, usize)>,
}

impl Picture {
    fn width(&self) -> usize {
        if self.steps.is_some() { 1 } else { 4 }
    }
}

/// A network that is put together, step by step in the order of execution.
#[derive(Debug)]
pub struct Builder {
    isa: Isa,
    pictures: Vec<Picture>,
    steps: Vec<(Work, [Tensor; 2], Tensor)>,
    scratch: usize,
}

impl Builder {
    /// Starts with the input. `steps`: bytes; without: floats.
    pub fn new(isa: Isa, input: Shape, steps: Option<Steps>) -> (Self, Tensor) {
        let isa = if isa.is_here() { isa } else { Isa::Portable };
        let mut builder = Self { isa, pictures: Vec::new(), steps: Vec::new(), scratch: 0 };
        let input = builder.picture(input, steps);
        (builder, input)
    }

    /// Shape of a picture.
    pub fn shape(&self, of: Tensor) -> Shape {
        self.pictures[of.0].shape
    }

    /// Steps of a picture of bytes.
    pub fn steps(&self, of: Tensor) -> Option<Steps> {
        self.pictures[of.0].steps
    }

    fn picture(&mut self, shape: Shape, steps: Option<Steps>) -> Tensor {
        self.pictures.push(Picture { shape, steps, part_of: None });
        Tensor(self.pictures.len() - 1)
    }

    fn push(
        &mut self,
        work: Work,
        from: [Tensor; 2],
        shape: Shape,
        steps: Option<Steps>,
    ) -> Tensor {
        let to = self.picture(shape, steps);
        self.steps.push((work, from, to));
        to
    }

    fn window(
        &self,
        input: Tensor,
        [kernel, stride, pad]: [usize; 3],
    ) -> Result<Window, PlanError> {
        let shape = self.shape(input);
        let from = [shape.height, shape.width];
        if kernel == 0 || stride == 0 || pad >= kernel || from.iter().any(|n| n + 2 * pad < kernel)
        {
            return refuse(format!(
                "a window of {kernel}, stride {stride}, pad {pad} over {from:?} pixels"
            ));
        }
        let to = from.map(|n| (n + 2 * pad - kernel) / stride + 1);
        Ok(Window { kernel, stride, pad, from, to })
    }

    /// A convolution.
    ///
    /// # Errors
    /// [`PlanError`] where there is no kernel for it or lengths do not fit.
    pub fn conv(&mut self, input: Tensor, conv: &Conv<'_>) -> Result<Tensor, PlanError> {
        let Picture { shape, steps, .. } = self.pictures[input.0].clone();
        let window = self.window(input, [conv.kernel, conv.stride, conv.pad])?;
        if conv.depthwise && (conv.channels != shape.channels || ![3, 5].contains(&conv.kernel)) {
            return refuse(format!(
                "depthwise over {} channels with {} outputs and a window of {}",
                shape.channels, conv.channels, conv.kernel
            ));
        }
        let expected = conv.weight_count(shape.channels);
        let (weights, biases) = match conv.weights {
            Weights::Int8 { values, bias, scales } => (values.len(), bias.len().min(scales.len())),
            Weights::Float { values, bias } => (values.len(), bias.len()),
        };
        if weights != expected || biases != conv.channels {
            return refuse(format!("{weights} weights and {biases} biases for {expected}"));
        }
        let [height, width] = window.to;
        let out = Shape { height, width, channels: conv.channels };
        let one = conv.kernel == 1 && conv.stride == 1 && conv.pad == 0;
        let (channels, count) = (shape.channels, out.pixels());
        let lanes = traits(self.isa).0;
        let (work, scratch) = match (conv.weights, steps) {
            (Weights::Int8 { values, scales, bias }, Some(steps)) => {
                let packed = conv.pack(self.isa, steps, channels, values, scales, bias);
                let outside = steps.zero;
                if conv.depthwise {
                    let padded = channels.next_multiple_of(lanes);
                    let column = conv.kernel.div_ceil(4) * 4 * padded;
                    let scratch = (shape.width + 2 * conv.pad) * column;
                    (Work::Depthwise { packed, window, outside }, scratch)
                } else if one {
                    (Work::Product { packed, count }, 0)
                } else {
                    let scratch = width * 4 * packed.fours;
                    (Work::Dense { packed, window, channels, outside }, scratch)
                }
            }
            (Weights::Float { values, bias }, None) if conv.out.is_none() => {
                let packed = conv.pack_f(self.isa, channels, values, bias);
                if conv.depthwise {
                    (Work::DepthwiseF { packed, window }, 0)
                } else if one {
                    (Work::ProductF { packed, count }, 0)
                } else {
                    let scratch = width * 4 * packed.inputs;
                    (Work::DenseF { packed, window, channels }, scratch)
                }
            }
            _ => return refuse("weights of another kind than the picture"),
        };
        self.scratch = self.scratch.max(scratch);
        Ok(self.push(work, [input; 2], out, conv.out))
    }

    /// The largest value under each window.
    ///
    /// # Errors
    /// [`PlanError`] where the window does not fit.
    pub fn pool(
        &mut self,
        input: Tensor,
        kernel: usize,
        stride: usize,
        pad: usize,
    ) -> Result<Tensor, PlanError> {
        let window = self.window(input, [kernel, stride, pad])?;
        let channels = self.shape(input).channels;
        let [height, width] = window.to;
        let work = match self.steps(input) {
            Some(_) => Work::Pool { window, channels },
            None => Work::PoolF { window, channels },
        };
        let shape = Shape { height, width, channels };
        Ok(self.push(work, [input; 2], shape, self.steps(input)))
    }

    /// Channels `first` to `first + channels` of a picture. Costs nothing.
    ///
    /// # Errors
    /// [`PlanError`] where it has fewer.
    pub fn slice(
        &mut self,
        input: Tensor,
        first: usize,
        channels: usize,
    ) -> Result<Tensor, PlanError> {
        let Picture { shape, steps, .. } = self.pictures[input.0].clone();
        if first + channels > shape.channels {
            return refuse(format!(
                "channels {first} to {} of {}",
                first + channels,
                shape.channels
            ));
        }
        let part = self.picture(Shape { channels, ..shape }, steps);
        self.pictures[part.0].part_of = Some((input, first));
        Ok(part)
    }

    fn alike(&self, a: Tensor, b: Tensor) -> Result<(), PlanError> {
        let (a, b) = (&self.pictures[a.0], &self.pictures[b.0]);
        if a.shape != b.shape || a.steps.is_some() != b.steps.is_some() {
            return refuse(format!("{:?} and {:?} together", a.shape, b.shape));
        }
        Ok(())
    }

    /// Channels of `a` and `b` in turn.
    ///
    /// # Errors
    /// [`PlanError`] where shapes or steps differ.
    pub fn interleave(&mut self, a: Tensor, b: Tensor) -> Result<Tensor, PlanError> {
        self.alike(a, b)?;
        let (shape, steps) = (self.shape(a), self.steps(a));
        if steps != self.steps(b) {
            return refuse("a shuffle of halves with different scales");
        }
        let (channels, count) = (shape.channels, shape.pixels());
        let work = match steps {
            Some(_) => Work::Interleave { channels, count },
            None => Work::InterleaveF { channels, count },
        };
        Ok(self.push(work, [a, b], Shape { channels: 2 * channels, ..shape }, steps))
    }

    /// Pictures behind one another, channel-wise. Costs nothing for pictures that can be
    /// written where they will lie.
    ///
    /// # Errors
    /// [`PlanError`] where sizes differ.
    pub fn concat(&mut self, parts: &[Tensor], steps: Option<Steps>) -> Result<Tensor, PlanError> {
        let Some(&first) = parts.first() else { return refuse("a concatenation of nothing") };
        let shape = self.shape(first);
        for &part in parts {
            let Shape { height, width, .. } = self.shape(part);
            let floats = self.steps(part).is_none();
            if (height, width) != (shape.height, shape.width) || floats != steps.is_none() {
                return refuse(format!("{shape:?} and {:?} together", self.shape(part)));
            }
        }
        let channels = parts.iter().map(|&part| self.shape(part).channels).sum();
        let whole = self.picture(Shape { channels, ..shape }, steps);
        let mut at = 0;
        for &part in parts {
            let place = &self.pictures[part.0];
            let (channels, own) = (place.shape.channels, place.part_of.is_none());
            if own && place.steps == steps && part.0 != 0 {
                self.pictures[part.0].part_of = Some((whole, at));
            } else {
                let to = self.slice(whole, at, channels)?;
                let work = self.carry(part, steps);
                self.steps.push((work, [part; 2], to));
            }
            at += channels;
        }
        Ok(whole)
    }

    /// The work of copying a picture to other steps.
    fn carry(&self, part: Tensor, steps: Option<Steps>) -> Work {
        let picture = &self.pictures[part.0];
        let (channels, count) = (picture.shape.channels, picture.shape.pixels());
        match (picture.steps, steps) {
            (Some(from), Some(to)) if from != to => {
                Work::Rescale { scale: rescale(from, to), channels, count }
            }
            _ => Work::Copy { bytes: channels * picture.width(), count },
        }
    }

    /// The picture in other steps.
    ///
    /// # Errors
    /// [`PlanError`] for floats.
    pub fn requantise(&mut self, input: Tensor, steps: Steps) -> Result<Tensor, PlanError> {
        match self.steps(input) {
            None => refuse("floats into steps"),
            Some(from) if from == steps => Ok(input),
            Some(_) => {
                let work = self.carry(input, Some(steps));
                Ok(self.push(work, [input; 2], self.shape(input), Some(steps)))
            }
        }
    }

    /// The sum of two pictures.
    ///
    /// # Errors
    /// [`PlanError`] where shapes differ.
    pub fn add(&mut self, a: Tensor, b: Tensor, steps: Option<Steps>) -> Result<Tensor, PlanError> {
        self.alike(a, b)?;
        let shape = self.shape(a);
        let (channels, count) = (shape.channels, shape.pixels());
        let work = match (self.steps(a), self.steps(b), steps) {
            (Some(from), Some(other), Some(to)) => {
                let scales = [rescale(from, to), rescale(other, to)];
                Work::Add { scales, channels, count }
            }
            (None, None, None) => Work::AddF { channels, count },
            _ => return refuse("a sum of bytes and floats"),
        };
        Ok(self.push(work, [a, b], shape, steps))
    }

    /// Twice as wide and high, linear between aligned pixel centres.
    pub fn double(&mut self, input: Tensor) -> Tensor {
        let Picture { shape, steps, .. } = self.pictures[input.0].clone();
        let (size, channels) = ([shape.height, shape.width], shape.channels);
        let work = match steps {
            Some(_) => Work::Double { size, channels },
            None => Work::DoubleF { size, channels },
        };
        let shape = Shape { height: 2 * shape.height, width: 2 * shape.width, channels };
        self.push(work, [input; 2], shape, steps)
    }

    /// Lays out the memory. `outputs` are pictures of floats.
    ///
    /// # Errors
    /// [`PlanError`] for an output of bytes.
    pub fn finish(self, outputs: &[Tensor]) -> Result<Net, PlanError> {
        if outputs.iter().any(|&output| self.steps(output).is_some()) {
            return refuse("an output of bytes");
        }
        let (offsets, bytes) = self.lay_out(outputs);
        let place = |tensor: Tensor| {
            let (mut at, mut first) = (tensor, 0);
            while let Some((whole, from)) = self.pictures[at.0].part_of {
                (at, first) = (whole, first + from);
            }
            let whole = &self.pictures[at.0];
            Place {
                offset: offsets[at.0] + first * whole.width(),
                stride: whole.shape.channels * whole.width(),
            }
        };
        let steps = self.steps.iter().map(|(work, from, to)| Step {
            work: work.clone(),
            from: from.map(place),
            to: place(*to),
        });
        let outputs = outputs.iter().map(|&output| (place(output), self.shape(output))).collect();
        Ok(Net {
            isa: self.isa,
            steps: steps.collect(),
            input: (place(Tensor(0)), self.pictures[0].clone()),
            outputs,
            arena: Arena::new(bytes, self.scratch),
        })
    }

    /// Where each whole picture begins, and how many bytes there are: pictures that are not
    /// needed at the same time share memory. Largest first, each as low as it fits.
    fn lay_out(&self, outputs: &[Tensor]) -> (Vec<usize>, usize) {
        let root = |mut tensor: Tensor| {
            while let Some((whole, _)) = self.pictures[tensor.0].part_of {
                tensor = whole;
            }
            tensor.0
        };
        let mut lives = vec![(usize::MAX, 0); self.pictures.len()];
        let mut touch = |tensor: Tensor, at: usize| {
            let life = &mut lives[root(tensor)];
            *life = (life.0.min(at), life.1.max(at));
        };
        touch(Tensor(0), 0);
        for (i, (_, from, to)) in self.steps.iter().enumerate() {
            for &tensor in from.iter().chain([to]) {
                touch(tensor, i + 1);
            }
        }
        for &output in outputs {
            touch(output, self.steps.len() + 1);
        }
        let bytes = |i: usize| {
            let picture = &self.pictures[i];
            let len = picture.shape.pixels() * picture.shape.channels * picture.width();
            (len + BEHIND).next_multiple_of(64)
        };
        let mut order: Vec<_> = (0..lives.len()).filter(|&i| lives[i].0 != usize::MAX).collect();
        order.sort_by_key(|&i| (std::cmp::Reverse(bytes(i)), i));
        let mut offsets = vec![0; lives.len()];
        let mut placed: Vec<usize> = Vec::new();
        let mut end = 0;
        for i in order {
            let mut taken: Vec<_> = placed
                .iter()
                .filter(|&&j| lives[j].0 <= lives[i].1 && lives[i].0 <= lives[j].1)
                .map(|&j| (offsets[j], offsets[j] + bytes(j)))
                .collect();
            taken.sort_unstable();
            let mut at = 0;
            for (from, to) in taken {
                if from >= at + bytes(i) {
                    break;
                }
                at = at.max(to);
            }
            offsets[i] = at;
            end = end.max(at + bytes(i));
            placed.push(i);
        }
        (offsets, end)
    }
}

fn rescale(from: Steps, to: Steps) -> Rescale {
    Rescale {
        factor: from.scale / to.scale,
        zero_from: f32::from(from.zero),
        zero_to: f32::from(to.zero),
    }
}

/// A network that is ready to run.
#[derive(Clone, Debug)]
pub struct Net {
    isa: Isa,
    steps: Vec<Step>,
    input: (Place, Picture),
    outputs: Vec<(Place, Shape)>,
    arena: Arena,
}

impl Net {
    /// The instruction set that it was put together for.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// Steps of the input, `None` for floats.
    pub fn input_steps(&self) -> Option<Steps> {
        self.input.1.steps
    }

    /// Bytes of memory that pictures share.
    pub fn memory(&self) -> usize {
        (self.arena.pictures.len() + self.arena.scratch.len()) * 64
    }

    fn input_len(&self) -> usize {
        self.input.1.shape.pixels() * self.input.1.shape.channels
    }

    /// The input to fill before each run, row by row, pixel by pixel, channels last; empty
    /// for a network of floats.
    pub fn input_bytes(&mut self) -> &mut [u8] {
        let len = if self.input_steps().is_some() { self.input_len() } else { 0 };
        let start = self.arena.pictures.as_mut_ptr().cast::<u8>();
        // SAFETY: the plan laid the input inside the arena, which is initialised.
        unsafe { std::slice::from_raw_parts_mut(start.add(self.input.0.offset), len) }
    }

    /// The input of a network of floats; empty for one of bytes.
    pub fn input_floats(&mut self) -> &mut [f32] {
        let len = if self.input_steps().is_none() { self.input_len() } else { 0 };
        let start = self.arena.pictures.as_mut_ptr().cast::<u8>();
        // SAFETY: as above; offsets are multiples of 64.
        unsafe { std::slice::from_raw_parts_mut(start.add(self.input.0.offset).cast(), len) }
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
            told(step.work.name(), begun.elapsed());
        }
    }

    /// Output `index`: pixels with their channels.
    pub fn output(&self, index: usize) -> impl Iterator<Item = &[f32]> {
        let (place, shape) = self.outputs[index];
        let start = self.arena.pictures.as_ptr().cast::<u8>();
        (0..shape.pixels()).map(move |i| {
            // SAFETY: the plan laid the output inside the arena, and nothing over it.
            unsafe {
                let pixel = start.add(place.offset + i * place.stride).cast();
                std::slice::from_raw_parts(pixel, shape.channels)
            }
        })
    }
}
