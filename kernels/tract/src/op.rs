//! A subgraph of a model as one operator of tract.
//!
//! Owns the way in and out: planes of tract's tensors to pixels of the kernels and back, and
//! the rows of cells. The arena lies in the operator's state; a plan that is run by several
//! states shares the weights.

use crate::lower::{Entry, Form, Lowered};
use crate::tail::{Gate, Part, complete};
use std::ops::ControlFlow;
use tract_core::internal::*;
use verge_kernels::{Net, QuantParams, Shape};

/// Adding it rounds values below 2^22 to the nearest even, and leaves them in the last bits.
const ROUND: f32 = 12_582_912.0;

/// Pixels that are turned together, so that both sides stay in the first cache.
const BLOCK: usize = 64;

/// A subgraph on the kernels.
#[derive(Clone, Debug)]
pub struct Subnet {
    lowered: Arc<Lowered>,
    facts: TVec<TypedFact>,
    /// Nodes of the model that it took the place of.
    nodes: usize,
}

impl PartialEq for Subnet {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.lowered, &other.lowered)
    }
}

impl Eq for Subnet {}

impl Subnet {
    pub(crate) fn new(lowered: Lowered, facts: TVec<TypedFact>, nodes: usize) -> Self {
        Self { lowered: Arc::new(lowered), facts, nodes }
    }

    /// Nodes of the model that it took the place of.
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    /// Whether it computes in bytes where it begins.
    pub fn is_quantised(&self) -> bool {
        self.lowered.plan.inputs().any(|(_, quant)| quant.is_some())
    }

    /// The instruction set that it was put together for.
    pub fn isa(&self) -> verge_kernels::Isa {
        self.lowered.plan.isa()
    }

    /// The parts of each column of the only output, where that is rows of cells.
    pub fn parts(&self) -> Option<&[Part]> {
        match &self.lowered.exits[..] {
            [exit] => match &exit.form {
                Form::Rows { parts, .. } => Some(parts),
                Form::Planes(_) => None,
            },
            _ => None,
        }
    }
}

impl Op for Subnet {
    fn name(&self) -> StaticName {
        "VergeSubnet".into()
    }

    fn info(&self) -> TractResult<Vec<String>> {
        let kind = if self.is_quantised() { "int8" } else { "f32" };
        Ok(vec![format!("{} nodes in {kind} on {}", self.nodes, self.isa().name())])
    }

    op_as_typed_op!();
}

impl EvalOp for Subnet {
    not_out_of_plan!();

    fn state(&self, _ctx: &EvalContext) -> TractResult<Option<Box<dyn OpState>>> {
        Ok(Some(Box::new(SubnetState::new(self))))
    }
}

impl TypedOp for Subnet {
    fn output_facts(&self, _inputs: &[&TypedFact]) -> TractResult<TVec<TypedFact>> {
        Ok(self.facts.clone())
    }

    as_op!();
}

/// The memory that a subgraph is computed in.
#[derive(Clone, Debug)]
pub struct SubnetState {
    lowered: Arc<Lowered>,
    net: Net,
    row: Vec<f32>,
}

/// An input as the kernels take it: row by row, pixel by pixel, channels last.
#[derive(Debug)]
pub enum Input<'a> {
    /// Bytes that count as the parameters say.
    Bytes(&'a mut [u8], QuantParams),
    /// Floats.
    Floats(&'a mut [f32]),
}

impl SubnetState {
    /// Memory of its own for `subnet`.
    pub fn new(subnet: &Subnet) -> Self {
        let lowered = subnet.lowered.clone();
        Self { net: lowered.plan.net(), row: Vec::new(), lowered }
    }

    /// The first input, to be filled in place before [`Self::run`]; tract's tensors are then
    /// not needed.
    pub fn input(&mut self) -> Input<'_> {
        match self.net.input_fact(0).1 {
            Some(quant) => Input::Bytes(self.net.input_bytes(0), quant),
            None => Input::Floats(self.net.input_floats(0)),
        }
    }

    /// Computes.
    pub fn run(&mut self) {
        self.net.run();
    }

    /// Calls `take` with index and row of each cell of output `exit` that passes `gate`, in the
    /// order of cells. Nothing is allocated after the first call.
    pub fn rows<B>(
        &mut self,
        exit: usize,
        gate: &Gate,
        mut take: impl FnMut(usize, &[f32]) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        let exit = &self.lowered.exits[exit];
        let Form::Rows { parts, .. } = &exit.form else { return ControlFlow::Continue(()) };
        let cells = exit.levels.iter().flat_map(|&level| self.net.output(level));
        for (cell, raw) in cells.enumerate() {
            if gate.passes(raw) {
                complete(parts, raw, &mut self.row);
                take(cell, &self.row)?;
            }
        }
        ControlFlow::Continue(())
    }

    /// Takes what tract gives for each input.
    ///
    /// # Errors
    /// Where they are of another kind than the model has.
    pub fn fill(&mut self, inputs: &[TValue]) -> TractResult<()> {
        let lowered = self.lowered.clone();
        let entries = lowered.entries.iter().zip(inputs).enumerate();
        entries.into_iter().try_for_each(|(index, (entry, input))| self.take(index, entry, input))
    }

    /// The computed output, in the model's own type and layout.
    ///
    /// # Errors
    /// Where `subnet` is another one's.
    pub fn outputs(&mut self, subnet: &Subnet) -> TractResult<TVec<TValue>> {
        let facts = subnet.facts.iter().enumerate();
        facts.map(|(index, fact)| Ok(self.output(index, fact)?.into_tvalue())).collect()
    }

    fn take(&mut self, index: usize, entry: &Entry, tensor: &Tensor) -> TractResult<()> {
        let (shape, quant) = self.net.input_fact(index);
        let view = tensor.try_as_plain_ram()?;
        match (entry.kind, quant) {
            (DatumType::F32, Some(quant)) => {
                let QuantParams { scale, zero_point } = quant;
                let (unit, zero) = (1.0 / scale, f32::from(zero_point));
                let to_byte = move |value: f32| {
                    // NaN becomes 0: `max` returns its other operand.
                    let value = (value * unit).max(-zero).min(255.0 - zero);
                    // The sum's last bits are the whole number; a conversion takes twice as long.
                    ((value + ROUND).to_bits() as u8).wrapping_add(zero_point)
                };
                to_pixels(view.as_slice::<f32>()?, self.net.input_bytes(index), shape, to_byte);
            }
            (DatumType::F32, None) => {
                to_pixels(view.as_slice::<f32>()?, self.net.input_floats(index), shape, |v| v);
            }
            (DatumType::U8, Some(_)) => {
                to_pixels(view.as_slice::<u8>()?, self.net.input_bytes(index), shape, |v| v);
            }
            (DatumType::I8, Some(_)) => {
                let lift = |v: i8| v.cast_unsigned() ^ 0x80;
                to_pixels(view.as_slice::<i8>()?, self.net.input_bytes(index), shape, lift);
            }
            (kind, _) => bail!("an input of {kind:?}"),
        }
        Ok(())
    }

    fn output(&mut self, index: usize, fact: &TypedFact) -> TractResult<Tensor> {
        let exit = self.lowered.exits.get(index).context("an output that it does not have")?;
        let shape = fact.shape.as_concrete().context("an output of unknown size")?;
        let mut tensor = Tensor::zero_dt(fact.datum_type, shape)?;
        let mut view = tensor.try_as_plain_ram_mut()?;
        match &exit.form {
            Form::Planes(kind) => {
                let level = exit.levels[0];
                let (size, quant) = self.net.output_fact(level);
                match (kind, quant) {
                    (DatumType::F32, None) => {
                        to_planes(self.net.output(level), view.as_slice_mut::<f32>()?, size, |v| v);
                    }
                    (DatumType::F32, Some(QuantParams { scale, zero_point })) => {
                        let zero = f32::from(zero_point);
                        let to_float = move |v: u8| (f32::from(v) - zero) * scale;
                        let pixels = self.net.output_bytes(level);
                        to_planes(pixels, view.as_slice_mut::<f32>()?, size, to_float);
                    }
                    (DatumType::U8, Some(_)) => {
                        let pixels = self.net.output_bytes(level);
                        to_planes(pixels, view.as_slice_mut::<u8>()?, size, |v| v);
                    }
                    (DatumType::I8, Some(_)) => {
                        let pixels = self.net.output_bytes(level);
                        let lower = |v: u8| (v ^ 0x80).cast_signed();
                        to_planes(pixels, view.as_slice_mut::<i8>()?, size, lower);
                    }
                    (kind, _) => bail!("an output of {kind:?}"),
                }
            }
            Form::Rows { parts, turned } => {
                let out = view.as_slice_mut::<f32>()?;
                let columns: usize = parts.iter().map(Part::columns).sum();
                let count = out.len() / columns.max(1);
                let cells = exit.levels.iter().flat_map(|&level| self.net.output(level));
                for (cell, raw) in cells.enumerate() {
                    complete(parts, raw, &mut self.row);
                    if *turned {
                        out[cell * columns..][..columns].copy_from_slice(&self.row);
                    } else {
                        for (column, &value) in self.row.iter().enumerate() {
                            out[column * count + cell] = value;
                        }
                    }
                }
            }
        }
        Ok(tensor)
    }
}

impl OpState for SubnetState {
    fn eval(
        &mut self,
        _ctx: &EvalContext,
        op: &dyn Op,
        inputs: TVec<TValue>,
    ) -> TractResult<TVec<TValue>> {
        let op = op.downcast_ref::<Subnet>().context("the state of another operator")?;
        self.fill(&inputs)?;
        self.run();
        self.outputs(op)
    }

    /// Nothing is kept from turn to turn.
    fn reset_lanes(&mut self, _lanes: &[LaneId]) -> TractResult<()> {
        Ok(())
    }
}

/// Planes into pixels.
fn to_pixels<T: Copy, U>(planes: &[T], pixels: &mut [U], shape: Shape, each: impl Fn(T) -> U) {
    let (count, channels) = (shape.height * shape.width, shape.channels);
    for (block, pixels) in pixels.chunks_mut(BLOCK * channels).enumerate() {
        let first = block * BLOCK;
        let here = pixels.len() / channels;
        for channel in 0..channels {
            let plane = &planes[channel * count + first..][..here];
            for (pixel, &value) in pixels.chunks_exact_mut(channels).zip(plane) {
                pixel[channel] = each(value);
            }
        }
    }
}

/// Pixels into planes.
fn to_planes<'a, T: Copy + 'a, U>(
    mut pixels: impl Iterator<Item = &'a [T]>,
    planes: &mut [U],
    shape: Shape,
    each: impl Fn(T) -> U,
) {
    let count = shape.height * shape.width;
    let mut block: [&[T]; BLOCK] = [&[]; BLOCK];
    let mut first = 0;
    loop {
        let here = block.iter_mut().zip(&mut pixels).map(|(place, pixel)| *place = pixel).count();
        if here == 0 {
            return;
        }
        for (channel, plane) in planes.chunks_exact_mut(count).enumerate() {
            for (value, pixel) in plane[first..][..here].iter_mut().zip(&block) {
                *value = each(pixel[channel]);
            }
        }
        first += here;
    }
}
