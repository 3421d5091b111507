//! A loaded net: tract's plan, with the kernels' operators in it.
//!
//! Owns input and output. Where an operator of the kernels alone reads the input, it is filled in
//! place; where one gives the cells, they are read where they lie. Where that is one and the same,
//! the whole net, nothing is copied or allocated for a frame.

use super::head::Head;
use super::letterbox::Into;
use super::load::{Loaded, Refused, Wanted, load};
use crate::daemon::frame::Detection;
use crate::daemon::memory;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};
use tract_onnx::tract_core::internal::*;
use tract_onnx::tract_core::plan;
use verge_tract::{Gate, Input, LeftToTract, Subnet, SubnetState};

/// The arithmetic that a model is run in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// As the model file says: in steps where it rounds, else in floats.
    #[default]
    AsStored,
    /// The same weights in 32-bit floats, without rounding in between.
    Float,
    /// As the file says, on the portable kernels: the reference for all others.
    Portable,
}

/// One of the parts that compute a net, and its share of the net's time.
#[derive(Clone, Debug, PartialEq)]
pub struct Share {
    /// The part: kernels with their instruction set, or tract with its operators.
    pub by: String,
    /// Nodes of the plan.
    pub nodes: usize,
    /// Of the time, 0 to 1.
    pub of_time: f64,
}

/// A loaded net.
#[derive(Debug)]
pub(super) struct Engine {
    state: TypedSimpleState,
    ends: Ends,
    gate: Option<Gate>,
    shape: [usize; 4],
    /// The input in tract's order, where it is not filled in place.
    planes: Vec<f32>,
    outputs: TVec<TValue>,
    left: Vec<LeftToTract>,
}

impl Engine {
    /// Loads `bytes`, the model file at `path`.
    pub(super) fn load(path: &Path, bytes: Vec<u8>, wanted: &Wanted) -> Result<Self, Refused> {
        let Loaded { model, size: [width, height], left } =
            memory::loading(|| load(path, bytes, wanted))?;
        let shape = [1, 3, height, width];
        let ends = Ends::of(&model, &shape)?;
        let planes = if ends.first.is_some() { Vec::new() } else { vec![0.0; 3 * height * width] };
        let state = model.into_runnable()?.spawn()?;
        Ok(Self { state, ends, gate: None, shape, planes, outputs: tvec!(), left })
    }

    /// Columns and rows of its input.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.shape[3], self.shape[2]]
    }

    /// Shapes of its outputs.
    pub(super) fn output_shapes(&self) -> Vec<Vec<usize>> {
        let model = self.state.model();
        let shape = |outlet| Some(model.outlet_fact(outlet).ok()?.shape.as_concrete()?.to_vec());
        model.outputs.iter().map(|outlet| shape(*outlet).unwrap_or_default()).collect()
    }

    /// From here on, only cells are looked at in which a score of `head` may reach its
    /// threshold.
    pub(super) fn look_for(&mut self, head: &Head) {
        let subnet = self.ends.last.and_then(|id| self.state.model().node(id).op_as::<Subnet>());
        let parts = subnet.and_then(Subnet::parts).unwrap_or_default();
        self.gate = Some(Gate::new(parts, &head.gate(), head.threshold()));
    }

    fn subnet(&mut self, node: Option<usize>) -> Option<&mut SubnetState> {
        self.state.op_states[node?].as_mut()?.downcast_mut()
    }

    /// In words: what computes, and the first part that is left to tract.
    pub(super) fn describe(&self) -> String {
        let kernels: Vec<&Subnet> =
            self.state.model().nodes().iter().filter_map(|node| node.op_as::<Subnet>()).collect();
        let first = kernels.first().map(|subnet| {
            let kind = if subnet.is_quantised() { "int8" } else { "f32" };
            format!("{kind} kernels, {}", subnet.isa().name())
        });
        let on_kernels: usize = kernels.iter().map(|subnet| subnet.nodes()).sum();
        let why = self
            .left
            .first()
            .map(|left| format!("{} {}: {}", left.operator, left.node, left.reason));
        match (first, why) {
            (Some(kernels), None) => kernels,
            (Some(kernels), Some(why)) => {
                let all = on_kernels + self.left.len();
                format!("{kernels} for {on_kernels} of {all} nodes, tract for the rest ({why})")
            }
            (None, why) => format!("tract ({})", why.unwrap_or_default()),
        }
    }

    /// Nodes that stay with tract.
    pub(super) fn left(&self) -> &[LeftToTract] {
        &self.left
    }

    /// Memory for the next picture.
    pub(super) fn input(&mut self) -> Into<'_> {
        if self.ends.first.is_none() {
            return Into::Planes(&mut self.planes);
        }
        match self.subnet(self.ends.first).map(SubnetState::input) {
            Some(Input::Bytes(bytes, quant)) => Into::Quantised(bytes, quant),
            Some(Input::Floats(floats)) => Into::Pixels(floats),
            None => Into::Planes(&mut []),
        }
    }

    /// Goes through the plan, and tells `took` the time of each node.
    fn go(&mut self, mut took: impl FnMut(usize, Duration)) -> TractResult<()> {
        let input = match &self.ends.unread {
            Some(unread) if self.ends.first.is_some() => unread.clone().into_tvalue(),
            _ => Tensor::from_shape(&self.shape, &self.planes)?.into_tvalue(),
        };
        let ends = &self.ends;
        self.outputs =
            self.state.run_plan_with_eval(tvec!(input), |context, state, node, inputs| {
                let begun = Instant::now();
                let made = ends.eval(context, state, node, inputs);
                took(node.id, begun.elapsed());
                made
            })?;
        Ok(())
    }

    /// Computes.
    pub(super) fn run(&mut self) -> Result<(), String> {
        if let Some(subnet) = self.subnet(self.ends.whole()) {
            subnet.run();
            return Ok(());
        }
        self.go(|_, _| {}).map_err(|error| format!("{error:#}"))
    }

    /// Computes `turns` times, and says what took which share of the time.
    pub(super) fn shares(&mut self, turns: usize) -> Result<Vec<Share>, String> {
        if self.ends.whole().is_some() {
            let by = self.describe();
            return Ok(vec![Share { by, nodes: 1, of_time: 1.0 }]);
        }
        let mut times: BTreeMap<usize, Duration> = BTreeMap::new();
        for _ in 0..turns.max(1) {
            let done = self.go(|node, time| *times.entry(node).or_default() += time);
            done.map_err(|error| format!("{error:#}"))?;
        }
        let mut shares: BTreeMap<String, (usize, Duration)> = BTreeMap::new();
        for (id, time) in times {
            let node = self.state.model().node(id);
            let by = match node.op_as::<Subnet>() {
                Some(subnet) => {
                    let kind = if subnet.is_quantised() { "int8" } else { "f32" };
                    format!("{kind} kernels, {}", subnet.isa().name())
                }
                None => format!("tract, {}", node.op.name()),
            };
            let share = shares.entry(by).or_default();
            *share = (share.0 + 1, share.1 + time);
        }
        let all: Duration = shares.values().map(|(_, time)| *time).sum();
        let part = |time: Duration| time.as_secs_f64() / all.as_secs_f64().max(1e-9);
        let mut shares: Vec<Share> = shares
            .into_iter()
            .map(|(by, (nodes, time))| Share { by, nodes, of_time: part(time) })
            .collect();
        shares.sort_by(|a, b| b.of_time.total_cmp(&a.of_time));
        Ok(shares)
    }

    /// Adds the candidates of what was computed last.
    pub(super) fn read(
        &mut self,
        head: &Head,
        candidates: &mut Vec<Detection>,
    ) -> Result<(), String> {
        if let (Some(id), Some(gate)) = (self.ends.last, &self.gate) {
            let state = self.state.op_states[id].as_mut();
            let subnet = state.and_then(|state| state.downcast_mut::<SubnetState>());
            let subnet = subnet.ok_or("the net has lost its memory")?;
            let found = subnet.rows(0, gate, |cell, row| {
                match head.consider(row, head.cell(cell), candidates) {
                    Ok(()) => ControlFlow::Continue(()),
                    Err(why) => ControlFlow::Break(why),
                }
            });
            return match found {
                ControlFlow::Continue(()) => Ok(()),
                ControlFlow::Break(why) => Err(why),
            };
        }
        let slices: Result<TVec<&[f32]>, String> = self
            .outputs
            .iter()
            .map(|value| {
                let view = value.try_as_plain_ram().map_err(|error| format!("{error:#}"))?;
                view.as_slice::<f32>().map_err(|error| format!("{error:#}"))
            })
            .collect();
        head.read(&slices?, candidates)
    }
}

/// Ends of the kernels' part of a net.
#[derive(Debug)]
struct Ends {
    /// The node of theirs that alone reads the input, and nothing else: it is filled in place.
    first: Option<usize>,
    /// The node of theirs that gives the only output, rows of cells: they are read in place.
    last: Option<usize>,
    /// Placeholder for tract where the input is filled in place and other nodes follow. Nobody
    /// reads it.
    unread: Option<Arc<Tensor>>,
}

impl Ends {
    fn of(model: &TypedModel, shape: &[usize]) -> TractResult<Self> {
        let [input] = model.inputs[..] else { bail!("{} inputs", model.inputs.len()) };
        let first = match model.outlet_successors(input) {
            [reader] if !model.outputs.contains(&input) => {
                let node = model.node(reader.node);
                let alone = node.op_is::<Subnet>() && node.inputs[..] == [input];
                alone.then_some(node.id)
            }
            _ => None,
        };
        let last = match model.outputs[..] {
            [output] if model.outlet_successors(output).is_empty() => {
                let node = model.node(output.node);
                let rows = node.op_as::<Subnet>().and_then(Subnet::parts);
                rows.is_some().then_some(node.id)
            }
            _ => None,
        };
        let mut ends = Self { first, last, unread: None };
        if first.is_some() && ends.whole().is_none() {
            let kind = model.outlet_fact(input)?.datum_type;
            ends.unread = Some(Tensor::zero_dt(kind, shape)?.into_arc_tensor());
        }
        Ok(ends)
    }

    /// The node that is the whole net.
    fn whole(&self) -> Option<usize> {
        self.first.filter(|_| self.first == self.last)
    }

    /// Evaluates a node of the plan, without the input and the output that are not tract's.
    fn eval(
        &self,
        context: &EvalContext,
        mut state: Option<&mut (dyn OpState + 'static)>,
        node: &TypedNode,
        inputs: TVec<TValue>,
    ) -> TractResult<TVec<TValue>> {
        let id = Some(node.id);
        let end = id == self.first || id == self.last;
        let subnet = state.as_deref_mut().filter(|_| end).and_then(|s| s.downcast_mut());
        let (Some(subnet), Some(op)) = (subnet, node.op_as::<Subnet>()) else {
            return plan::eval(context, state, node, inputs);
        };
        let subnet: &mut SubnetState = subnet;
        if id != self.first {
            subnet.fill(&inputs)?;
        }
        subnet.run();
        if id == self.last { Ok(tvec!(tensor0(0f32).into_tvalue())) } else { subnet.outputs(op) }
    }
}
