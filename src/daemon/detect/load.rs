//! A model file into a plan of tract.
//!
//! Owns the way from bytes to something that runs: tract reads the file, its input gets the size
//! that is asked for, half precision becomes single, and what the kernels know goes onto them
//! (`verge-tract`). A panic of tract at a damaged file is a refusal with its words.

use super::engine::Precision;
use super::error::sizes;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use tract_onnx::tract_core::transform::{NodeFilter, build_float_translator};
use tract_onnx::tract_hir::internal::*;
use verge_tract::{
    Isa, KernelTransform, LeftToTract, keep_quantised, with_input_size, without_rounding,
};

/// Columns and rows of an input that neither the file nor anyone else fixes.
const DEFAULT_SIZE: [usize; 2] = [640, 480];

/// Longest side of an input, px, and most values of anything that is computed: sixteen times
/// what a 4K picture has. A file that asks for more is damaged or meant to do harm.
const MOST_PX: usize = 4096;
const MOST_VALUES: usize = 1 << 27;

/// Settings of loading.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    /// Columns and rows that the file must have, if it fixes them.
    pub(super) stored: Option<[usize; 2]>,
    /// Columns and rows of the input, in place of the file's.
    pub(super) size: Option<[usize; 2]>,
    pub(super) precision: Precision,
}

/// A model that is ready to run.
#[derive(Debug)]
pub(super) struct Loaded {
    pub(super) model: TypedModel,
    /// Columns and rows of its input.
    pub(super) size: [usize; 2],
    /// Nodes that the kernels do not know.
    pub(super) left: Vec<LeftToTract>,
}

/// Why a file cannot be used.
#[derive(Debug)]
pub(super) enum Refused {
    /// tract's reason.
    Reason(String),
    /// The shape of the input in the file.
    Input(Vec<usize>),
}

impl From<TractError> for Refused {
    fn from(error: TractError) -> Self {
        Self::Reason(format!("{error:#}"))
    }
}

/// Loads `bytes`, which lie at `path`; data outside the file are looked for beside it.
pub(super) fn load(path: &Path, bytes: Vec<u8>, wanted: &Wanted) -> Result<Loaded, Refused> {
    // tract's state is gone with the unwinding; nothing of it is seen again.
    let made = catch_unwind(AssertUnwindSafe(|| read(path, bytes, wanted)));
    made.unwrap_or_else(|panic| {
        let words = panic.downcast_ref::<String>().map(String::as_str);
        let words = words.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no reason");
        Err(Refused::Reason(format!("tract gave up: {words}")))
    })
}

fn read(path: &Path, bytes: Vec<u8>, wanted: &Wanted) -> Result<Loaded, Refused> {
    let onnx = tract_onnx::onnx().with_ignore_value_info(true);
    let proto = onnx.proto_model_for_read(&mut &bytes[..])?;
    drop(bytes);
    let folder = path.parent().and_then(Path::to_str);
    let parsed = onnx.parse(&proto, folder)?;
    drop(proto);
    if let Some(name) = parsed.unresolved_inputs.first() {
        return Err(Refused::Reason(format!("nothing gives {name}")));
    }
    let mut model = parsed.model;
    if model.inputs.len() != 1 {
        let names = model.inputs.iter().map(|input| model.node(input.node).name.clone());
        let names: Vec<String> = names.collect();
        let names = names.join(", ");
        return Err(Refused::Reason(format!(
            "it has {} inputs ({names}), one is wanted",
            model.inputs.len()
        )));
    }
    let fact = model.input_fact(0)?.clone();
    let kind = fact.datum_type.concretize().unwrap_or(f32::datum_type());
    let dims: Vec<Option<usize>> =
        fact.shape.dims().map(|dim| dim.concretize().and_then(|dim| dim.to_usize().ok())).collect();
    let given = |axis: usize| dims.get(axis).copied().flatten();
    let (stored, size) = (wanted.stored.unwrap_or(DEFAULT_SIZE), wanted.size);
    let asked = size.unwrap_or([given(3).unwrap_or(stored[0]), given(2).unwrap_or(stored[1])]);
    let [width, height] = asked;
    let fixed = [
        given(0).unwrap_or(1),
        given(1).unwrap_or(3),
        given(2).unwrap_or(height),
        given(3).unwrap_or(width),
    ];
    let fits = |axis: usize, stored: usize| {
        wanted.stored.is_none() || given(axis).is_none_or(|length| length == stored)
    };
    if width == 0 || height == 0 || width.max(height) > MOST_PX {
        let reason = format!("an input of {width}x{height} px, each side may have {MOST_PX}");
        return Err(Refused::Reason(reason));
    }
    let right = fixed[..2] == [1, 3] && fits(2, stored[1]) && fits(3, stored[0]);
    if !right || (!fact.shape.is_open() && dims.len() != 4) {
        return Err(Refused::Input(dims.iter().map(|dim| dim.unwrap_or(0)).collect()));
    }
    model.set_input_fact(0, InferenceFact::dt_shape(kind, &fixed[..]))?;
    keep_quantised(&mut model);
    let mut model = model.into_typed()?;
    for node in model.nodes() {
        let shapes = node.outputs.iter().map(|outlet| &outlet.fact.shape);
        for shape in shapes.filter_map(|shape| shape.as_concrete()) {
            let values = shape.iter().try_fold(1usize, |all, &length| all.checked_mul(length));
            if values.is_none_or(|values| values > MOST_VALUES) {
                return Err(Refused::Reason(format!(
                    "{} gives more values than verge takes: {}",
                    node.name,
                    sizes(&[shape.to_vec()])
                )));
            }
        }
    }
    if is_half(&model) {
        let to =
            build_float_translator(f16::datum_type(), f32::datum_type(), NodeFilter::default());
        to.transform(&mut model)?;
    }
    if fixed[2..] != [height, width] {
        model = with_input_size(&model, [height, width]).map_err(|error| {
            Refused::Reason(format!("it cannot take an input of {width}x{height} px: {error:#}"))
        })?;
    }
    if wanted.precision == Precision::Float {
        model = without_rounding(&model)?;
    }
    let isa = match wanted.precision {
        Precision::Portable => Isa::Portable,
        Precision::AsStored | Precision::Float => Isa::best(),
    };
    let left = KernelTransform { isa }.apply(&mut model)?;
    Ok(Loaded { model: model.into_optimized()?, size: asked, left })
}

/// Whether anything in it is in half precision.
fn is_half(model: &TypedModel) -> bool {
    let outlets = model.nodes().iter().flat_map(|node| &node.outputs);
    outlets.into_iter().any(|outlet| outlet.fact.datum_type == f16::datum_type())
}
