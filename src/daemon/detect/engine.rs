//! What computes a net: the project's own kernels, or tract.
//!
//! Owns the choice between them and the input and output of both.

use super::head::Head;
use super::letterbox::Into;
use super::lower::{Lowered, lower};
use super::onnx::ModelProto;
use super::sidecar::Sidecar;
use super::tail::Tail;
use super::{ModelError, forms, operators};
use crate::daemon::frame::Detection;
use prost::Message;
use std::path::Path;
use std::sync::Arc;
use tract_hir::prelude::{
    IntoRunnable, TValue, Tensor, TractError, TypedModel, TypedRunnableModel, tvec,
};
use verge_kernels::{Isa, Net};

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

/// A loaded net.
#[derive(Debug)]
pub(super) enum Engine {
    /// On the kernels.
    Kernels { net: Box<Net>, levels: usize, tail: Tail, row: Vec<f32> },
    /// In tract, with the input's planes and the reason why.
    Tract { plan: Arc<TypedRunnableModel>, shape: [usize; 4], planes: Vec<f32>, why: String },
}

/// What an engine gave.
#[derive(Debug)]
pub(super) enum Output {
    /// It lies in the net.
    Inside,
    /// tract's own.
    Tract(TValue),
}

impl Engine {
    /// Loads `bytes`, the model file at `path`, whose input has the size `stored`, columns and
    /// rows, for an input of the sidecar's size.
    pub(super) fn load(
        path: &Path,
        bytes: Vec<u8>,
        stored: [usize; 2],
        sidecar: &Sidecar,
        head: &Head,
        precision: Precision,
    ) -> Result<Self, ModelError> {
        let load = |error: TractError| ModelError::Load {
            path: path.to_owned(),
            reason: format!("{error:#}"),
        };
        let mismatch = |what, expected: &[usize], actual: &[usize]| ModelError::Shape {
            path: path.to_owned(),
            what,
            expected: expected.to_vec(),
            actual: actual.to_vec(),
        };
        let proto = ModelProto::decode(&bytes[..]).map_err(|error| ModelError::Load {
            path: path.to_owned(),
            reason: error.to_string(),
        })?;
        drop(bytes);
        let (width, height) = (sidecar.input.width_px, sidecar.input.height_px);
        let shape = [1, 3, height, width];
        let in_file = [1, 3, stored[1], stored[0]];
        let size = Some([width, height]).filter(|size| *size != stored);
        let why = match Self::on_kernels(&proto, precision, size) {
            Ok(Lowered { net, levels, parts, input }) => {
                if input != in_file {
                    return Err(mismatch("the input", &in_file, &input));
                }
                let columns = parts.iter().map(super::tail::Part::columns).sum();
                let cells = (0..levels).map(|level| net.output(level).count()).sum();
                let expected = head.output_shape();
                if [1, cells, columns] != expected || levels != head.levels() {
                    return Err(mismatch("the output", &expected, &[1, cells, columns]));
                }
                let tail = Tail::new(parts, head.scores(), sidecar.thresholds.score);
                let row = Vec::with_capacity(columns);
                return Ok(Self::Kernels { net: Box::new(net), levels, tail, row });
            }
            Err(why) => why,
        };
        if size.is_some() {
            let reason = format!("it cannot take an input of {width}x{height} px: {why}");
            return Err(ModelError::Load { path: path.to_owned(), reason });
        }
        let given = proto.graph.as_ref().and_then(|graph| graph.input.first()?.shape());
        if let Some(actual) = given.filter(|actual| *actual != in_file) {
            return Err(mismatch("the input", &in_file, &actual));
        }
        // tract would round in operators of their own, slower than not at all.
        let proto = forms::unrounded(proto);
        let model =
            operators::model(&proto, shape).and_then(TypedModel::into_optimized).map_err(load)?;
        let output = model.output_fact(0).map_err(load)?;
        let actual: Vec<usize> = output.shape.as_concrete().map(<[_]>::to_vec).unwrap_or_default();
        let expected = head.output_shape();
        if actual != expected {
            return Err(mismatch("the output", &expected, &actual));
        }
        let plan = model.into_runnable().map_err(load)?;
        Ok(Self::Tract { plan, shape, planes: vec![0.0; 3 * height * width], why })
    }

    fn on_kernels(
        proto: &ModelProto,
        precision: Precision,
        size: Option<[usize; 2]>,
    ) -> Result<Lowered, String> {
        let isa = match precision {
            Precision::Portable => Isa::Portable,
            Precision::AsStored | Precision::Float => Isa::best(),
        };
        let graph = proto.graph.as_ref().ok_or("a file without a graph")?;
        lower(graph, precision == Precision::Float, isa, size)
    }

    /// In words.
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Kernels { net, .. } => {
                let kind = if net.input_fact(0).1.is_some() { "int8" } else { "f32" };
                format!("{kind} kernels, {}", net.isa().name())
            }
            Self::Tract { why, .. } => format!("tract ({why})"),
        }
    }

    /// Where the next picture goes.
    pub(super) fn input(&mut self) -> Into<'_> {
        match self {
            Self::Tract { planes, .. } => Into::Planes(planes),
            Self::Kernels { net, .. } => match net.input_fact(0).1 {
                Some(steps) => Into::Quantised(net.input_bytes(0), steps),
                None => Into::Pixels(net.input_floats(0)),
            },
        }
    }

    /// Computes.
    pub(super) fn run(&mut self) -> Result<Output, String> {
        match self {
            Self::Kernels { net, .. } => {
                net.run();
                Ok(Output::Inside)
            }
            Self::Tract { plan, shape, planes, .. } => {
                let failed = |error: TractError| format!("{error:#}");
                let tensor = Tensor::from_shape(&shape[..], planes).map_err(failed)?;
                let output = plan.run(tvec!(tensor.into())).map_err(failed)?;
                let first = output.into_iter().next();
                first.map(Output::Tract).ok_or_else(|| "the model has no output".to_owned())
            }
        }
    }

    /// Adds the candidates of `output`.
    pub(super) fn read(
        &mut self,
        output: &Output,
        head: &Head,
        candidates: &mut Vec<Detection>,
    ) -> Result<(), String> {
        match (self, output) {
            (Self::Kernels { net, levels, tail, row }, Output::Inside) => {
                for level in 0..*levels {
                    for (cell, raw) in head.cells(level).zip(net.output(level)) {
                        if tail.may_count(raw) {
                            tail.complete(raw, row);
                            head.consider(row, cell, candidates);
                        }
                    }
                }
                Ok(())
            }
            (_, Output::Tract(value)) => {
                let view =
                    value.to_plain_array_view::<f32>().map_err(|error| format!("{error:#}"))?;
                head.read(view.as_slice().unwrap_or_default(), candidates);
                Ok(())
            }
            (Self::Tract { .. }, Output::Inside) => Err("an output of another net".to_owned()),
        }
    }
}
