//! Partition of a model's nodes into regions for the kernels.
//!
//! Owns the colouring. All nodes that are recognised and of one colour become one operator;
//! what is not recognised stays with tract, node by node, between them.

use crate::graph::{Refusal, View};
use crate::lower::{Lowered, Lowering};
use std::collections::{BTreeMap, HashMap, HashSet};
use tract_core::internal::*;
use tract_core::ops::konst::Const;
use tract_core::ops::quant::DequantizeLinearF32;
use verge_kernels::Isa;

/// A region that goes onto the kernels.
#[derive(Debug)]
pub(crate) struct Region {
    pub(crate) nodes: usize,
    pub(crate) lowered: Lowered,
}

/// The recognised regions, and the reasons for the rest.
#[derive(Debug)]
pub(crate) struct Partition {
    pub(crate) regions: Vec<Region>,
    pub(crate) refused: BTreeMap<usize, Refusal>,
}

/// Nodes whose values follow from the model's input, in the order of evaluation.
fn computed(model: &TypedModel) -> TractResult<(Vec<usize>, HashSet<usize>)> {
    let mut set: HashSet<usize> = model.inputs.iter().map(|input| input.node).collect();
    let mut order = Vec::new();
    for id in model.eval_order()? {
        let node = model.node(id);
        if !set.contains(&id) && node.inputs.iter().any(|input| set.contains(&input.node)) {
            set.insert(id);
            // Nodes that depend on shapes alone are constant.
            if !node.op_is::<Const>() {
                order.push(id);
            }
        }
    }
    Ok((order, set))
}

/// The colour of each node: as large as that of what it reads, and one more wherever a value
/// crosses between tract and the kernels. A way out of a region never leads back into it.
fn colours(
    model: &TypedModel,
    order: &[usize],
    refused: &BTreeMap<usize, Refusal>,
) -> HashMap<usize, usize> {
    let mut colours: HashMap<usize, usize> = HashMap::new();
    for &id in order {
        let ours = !refused.contains_key(&id);
        let from = model.node(id).inputs.iter().filter_map(|input| {
            let colour = colours.get(&input.node)?;
            let crossed = refused.contains_key(&input.node) == ours;
            Some(colour + usize::from(crossed))
        });
        let colour = from.max().unwrap_or(0);
        colours.insert(id, colour);
    }
    // A DequantizeLinear goes to its reader: between two regions bytes cross, and not floats.
    for &id in order.iter().filter(|id| !refused.contains_key(id)) {
        let node = model.node(id);
        if !node.op_is::<DequantizeLinearF32>() || model.outputs.contains(&id.into()) {
            continue;
        }
        let readers = model.outlet_successors(id.into());
        let colour = |reader: &InletId| {
            let ours = !refused.contains_key(&reader.node);
            ours.then(|| colours.get(&reader.node).copied()).flatten()
        };
        let first = readers.first().and_then(colour);
        if let Some(first) =
            first.filter(|&first| readers.iter().all(|reader| colour(reader) == Some(first)))
        {
            colours.insert(id, first);
        }
    }
    colours
}

/// Gives each region that reads a DequantizeLinear of another one its own; whether one did. With
/// [`colours`] it then lies in its reader's region.
pub(crate) fn share_out(
    model: &mut TypedModel,
    refused: &BTreeMap<usize, Refusal>,
) -> TractResult<bool> {
    let (order, _) = computed(model)?;
    let colours = colours(model, &order, refused);
    let mut copies = Vec::new();
    for &id in order.iter().filter(|id| !refused.contains_key(id)) {
        if !model.node(id).op_is::<DequantizeLinearF32>() {
            continue;
        }
        let mut far: BTreeMap<usize, Vec<InletId>> = BTreeMap::new();
        for reader in model.outlet_successors(id.into()) {
            if let Some(&colour) = colours.get(&reader.node)
                && !refused.contains_key(&reader.node)
                && colour > colours[&id]
            {
                far.entry(colour).or_default().push(*reader);
            }
        }
        copies.extend(far.into_iter().map(|(colour, readers)| (id, colour, readers)));
    }
    for (id, colour, readers) in &copies {
        let node = model.node(*id);
        let (name, op, inputs) =
            (format!("{}.{colour}", node.name), node.op.clone(), node.inputs.clone());
        let copy = model.wire_node(name, op, &inputs)?[0];
        readers.iter().try_for_each(|&reader| model.add_edge(copy, reader))?;
    }
    Ok(!copies.is_empty())
}

/// Puts as much of `model` as is recognised onto the kernels of `isa`.
pub(crate) fn partition(model: &TypedModel, isa: Isa) -> TractResult<Partition> {
    let view = View { model };
    let (order, computed) = computed(model)?;
    let mut refused: BTreeMap<usize, Refusal> = BTreeMap::new();
    loop {
        let colours = colours(model, &order, &refused);
        let mut regions: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for &id in order.iter().filter(|id| !refused.contains_key(id)) {
            regions.entry(colours[&id]).or_default().push(id);
        }
        let before = refused.len();
        let mut lowerings = Vec::new();
        for nodes in regions.values() {
            let lowering = Lowering::new(view, &computed, nodes, isa);
            if lowering.refused.is_empty() {
                lowerings.push((nodes, lowering));
            } else {
                refused.extend(lowering.refused);
            }
        }
        let asked: HashSet<OutletId> =
            lowerings.iter().flat_map(|(_, lowering)| lowering.entries()).collect();
        let mut done = Vec::new();
        for (nodes, lowering) in lowerings {
            let outputs = outputs(model, nodes, &asked);
            let unfinished = lowering.unfinished(&outputs);
            if !unfinished.is_empty() {
                let why = "the middle of a shuffle that goes on in tract".to_owned();
                refused.extend(unfinished.into_iter().map(|id| (id, why.clone())));
                continue;
            }
            let convolutions = lowering.convolutions;
            let mut leave = |why: Refusal| {
                refused.extend(nodes.iter().map(|&id| (id, why.clone())));
            };
            match lowering.finish(&outputs) {
                Err(why) => leave(why),
                // Each way in and out is a pass over memory, as a small convolution is.
                Ok(lowered) if convolutions < lowered.entries.len() + lowered.exits.len() - 1 => {
                    leave("too few convolutions between what is left to tract".to_owned());
                }
                Ok(lowered) => done.push(Region { nodes: nodes.len(), lowered }),
            }
        }
        if refused.len() == before {
            return Ok(Partition { regions: done, refused });
        }
    }
}

/// Outlets read outside of `nodes`, by tract or, as `asked`, by another region.
fn outputs(model: &TypedModel, nodes: &[usize], asked: &HashSet<OutletId>) -> Vec<OutletId> {
    let inside: HashSet<usize> = nodes.iter().copied().collect();
    let outlets = nodes
        .iter()
        .flat_map(|&id| (0..model.node(id).outputs.len()).map(move |slot| OutletId::new(id, slot)));
    outlets
        .filter(|outlet| {
            let readers = model.outlet_successors(*outlet);
            model.outputs.contains(outlet)
                || asked.contains(outlet)
                || readers.iter().any(|r| !inside.contains(&r.node))
        })
        .collect()
}
