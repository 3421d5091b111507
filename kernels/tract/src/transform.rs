//! The transform that puts subgraphs of a typed model onto the kernels.

use crate::constant::make_floats;
use crate::op::Subnet;
use crate::partition::{Partition, partition, share_out};
use std::collections::HashMap;
use tract_core::internal::*;
use tract_core::transform::ModelTransform;
use verge_kernels::Isa;

/// Puts every recognised subgraph of a typed model into one operator each, a [`Subnet`]. To be
/// used before decluttering, which folds quantisation into tables.
#[derive(Clone, Copy, Debug)]
pub struct KernelTransform {
    /// The instruction set of the kernels.
    pub isa: Isa,
}

impl Default for KernelTransform {
    fn default() -> Self {
        Self { isa: Isa::best() }
    }
}

/// A node that stays with tract.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftToTract {
    /// Its name in the model.
    pub node: String,
    /// Its operator.
    pub operator: String,
    /// The reason.
    pub reason: String,
}

impl KernelTransform {
    /// As [`ModelTransform::transform`], and tells what stays with tract.
    ///
    /// # Errors
    /// tract's, where the model is not in order.
    pub fn apply(&self, model: &mut TypedModel) -> TractResult<Vec<LeftToTract>> {
        let mut parts = partition(model, self.isa)?;
        if share_out(model, &parts.refused)? {
            parts = partition(model, self.isa)?;
        }
        let Partition { regions, refused } = parts;
        let left = refused.into_iter().map(|(id, reason)| {
            let node = model.node(id);
            LeftToTract { node: node.name.clone(), operator: node.op.name().into_owned(), reason }
        });
        let left = left.collect();
        // Where values lie once the region that gives them is one operator.
        let mut moved: HashMap<OutletId, OutletId> = HashMap::new();
        for (index, region) in regions.into_iter().enumerate() {
            let mut patch = TypedModelPatch::default();
            let lowered = region.lowered;
            let taps: TVec<OutletId> = lowered
                .entries
                .iter()
                .map(|entry| {
                    let outlet = moved.get(&entry.outlet).copied().unwrap_or(entry.outlet);
                    patch.tap_model(model, outlet)
                })
                .collect::<TractResult<_>>()?;
            let outlets: Vec<OutletId> = lowered.exits.iter().map(|exit| exit.outlet).collect();
            let facts = outlets.iter().map(|&outlet| {
                let fact = model.outlet_fact(outlet)?;
                Ok(fact.datum_type.fact(fact.shape.clone()))
            });
            let op = Subnet::new(lowered, facts.collect::<TractResult<_>>()?, region.nodes);
            let name = format!("verge.{index}");
            let wires = patch.wire_node(&name, op, &taps)?;
            for (outlet, wire) in outlets.iter().zip(wires) {
                patch.shunt_outside(model, *outlet, wire)?;
            }
            patch.apply(model)?;
            let node = model.node_id_by_name(&name)?;
            let places = (0..).map(|slot| OutletId::new(node, slot));
            moved.extend(outlets.into_iter().zip(places));
        }
        model.compact()?;
        make_floats(model)?;
        Ok(left)
    }
}

impl ModelTransform for KernelTransform {
    fn name(&self) -> StaticName {
        "verge_kernels".into()
    }

    fn transform(&self, model: &mut TypedModel) -> TractResult<()> {
        self.apply(model).map(drop)
    }
}
