//! Models on the kernels against the same models in tract alone.

use tract_core::internal::*;
use tract_core::ops::array::{Slice, TypedConcat};
use tract_core::ops::cast::cast;
use tract_core::ops::cnn::{Conv, KernelFormat, MaxPool, PaddingSpec, PoolSpec};
use tract_core::ops::element_wise::ElementWiseOp;
use tract_core::ops::math::{add, mul, sub, tanh};
use tract_core::ops::nn::{DataFormat, leaky_relu, sigmoid};
use tract_core::ops::quant::{DequantizeLinearF32, quantize_linear_i8, quantize_linear_u8};
use verge_tract::{Gate, KernelTransform, Subnet, SubnetState, with_input_size, without_rounding};

/// A small generator with a seed; xorshift.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn floats(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| (self.next() >> 40) as f32 / (1 << 23) as f32 - 1.0).collect()
    }
}

/// How values between operators are stored.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Float,
    Unsigned,
    Signed,
}

/// A model that is put together.
struct Maker {
    model: TypedModel,
    kind: Kind,
    random: Random,
    count: usize,
}

impl Maker {
    fn new(kind: Kind, size: [usize; 2]) -> (Self, OutletId) {
        let mut model = TypedModel::default();
        let fact = f32::fact([1, 3, size[0], size[1]]);
        let input = model.add_source("input", fact).expect("a source");
        let mut maker = Self { model, kind, random: Random(5), count: 0 };
        let input = maker.rounded(input);
        (maker, input)
    }

    fn wire(&mut self, op: impl Into<Box<dyn TypedOp>>, inputs: &[OutletId]) -> OutletId {
        self.count += 1;
        let name = format!("node{}", self.count);
        self.model.wire_node(name, op, inputs).expect("a node")[0]
    }

    fn konst(&mut self, tensor: Tensor) -> OutletId {
        self.count += 1;
        self.model.add_const(format!("const{}", self.count), tensor).expect("a constant")
    }

    /// Through bytes and back.
    fn rounded(&mut self, input: OutletId) -> OutletId {
        let scale = 0.015;
        let (quantise, zero): (ElementWiseOp, i32) = match self.kind {
            Kind::Float => return input,
            Kind::Unsigned => (quantize_linear_u8(1.0 / scale, 120), 120),
            Kind::Signed => (quantize_linear_i8(1.0 / scale, -8), -8),
        };
        let bytes = self.wire(quantise, &[input]);
        self.wire(DequantizeLinearF32::new(scale, zero), &[bytes])
    }

    /// Constants as a QDQ model has them: bytes, less their zero, times a scale by channel.
    fn weights(&mut self, shape: [usize; 4]) -> OutletId {
        let count: usize = shape.iter().product();
        let values = self.random.floats(count);
        let reach = 1.5 / ((count / shape[0]) as f32).sqrt();
        if self.kind == Kind::Float {
            let values: Vec<f32> = values.iter().map(|v| v * reach).collect();
            return self.konst(Tensor::from_shape(&shape, &values).expect("weights"));
        }
        let bytes: Vec<i8> = values.iter().map(|v| (v * 127.0) as i8).collect();
        let scales: Vec<f32> =
            (0..shape[0]).map(|i| reach * (1.0 + i as f32 / 50.0) / 127.0).collect();
        let bytes = self.konst(Tensor::from_shape(&shape, &bytes).expect("weights"));
        let wide = self.wire(cast(f32::datum_type()), &[bytes]);
        let along = [shape[0], 1, 1, 1];
        let zero = self.konst(Tensor::zero::<f32>(&along).expect("zeros"));
        let scale = self.konst(Tensor::from_shape(&along, &scales).expect("scales"));
        let less = self.wire(sub(), &[wide, zero]);
        self.wire(mul(), &[less, scale])
    }

    fn conv(
        &mut self,
        input: OutletId,
        channels: usize,
        kernel: usize,
        stride: usize,
        deep: bool,
    ) -> OutletId {
        let seen =
            self.model.outlet_fact(input).expect("a fact").shape[1].to_usize().expect("known");
        let weights = self.weights([channels, if deep { 1 } else { seen }, kernel, kernel]);
        let bias = self.random.floats(channels);
        let bias = self.konst(tensor1(&bias));
        let pad: TVec<usize> = tvec![kernel / 2; 2];
        let spec = PoolSpec::new(
            DataFormat::NCHW,
            tvec![kernel; 2],
            PaddingSpec::Explicit(pad.clone(), pad),
            None,
            Some(tvec![stride; 2]),
            seen,
            channels,
        );
        let group = if deep { channels } else { 1 };
        let op = Conv::new(spec, KernelFormat::OIHW, group, None);
        self.wire(op, &[input, weights, bias])
    }

    /// With rectifier and rounding.
    fn block(
        &mut self,
        input: OutletId,
        channels: usize,
        kernel: usize,
        stride: usize,
        deep: bool,
    ) -> OutletId {
        let sums = self.conv(input, channels, kernel, stride, deep);
        let active = self.wire(leaky_relu(0.1), &[sums]);
        self.rounded(active)
    }

    fn pool(&mut self, input: OutletId, channels: usize) -> OutletId {
        let pad: TVec<usize> = tvec![1; 2];
        let spec = PoolSpec::new(
            DataFormat::NCHW,
            tvec![3; 2],
            PaddingSpec::ExplicitOnnxPool(pad.clone(), pad, false),
            None,
            Some(tvec![2; 2]),
            channels,
            channels,
        );
        let pooled = self.wire(MaxPool::new(spec, None), &[input]);
        self.rounded(pooled)
    }

    /// Channels of both halves in turn, as a ShuffleNet unit has it.
    fn shuffled(&mut self, a: OutletId, b: OutletId) -> OutletId {
        let joined = self.wire(TypedConcat::new(1), &[a, b]);
        let joined = self.rounded(joined);
        let channels = self.model.outlet_fact(joined).expect("a fact").shape[1].clone();
        let half = channels.clone() / 2;
        let two = 2.to_dim();
        let op = AxisOp::Reshape(1, tvec!(channels.clone()), tvec!(two.clone(), half.clone()));
        let grouped = self.wire(op, &[joined]);
        let turned = self.wire(AxisOp::Move(1, 2), &[grouped]);
        self.wire(AxisOp::Reshape(1, tvec!(half, two), tvec!(channels)), &[turned])
    }

    fn sliced(&mut self, input: OutletId, from: usize, to: usize) -> OutletId {
        self.wire(Slice::new(1, from, to), &[input])
    }

    /// Cells of two levels, scores after a sigmoid, one row each.
    fn head(&mut self, levels: [OutletId; 2]) -> OutletId {
        let rows = levels.map(|level| {
            let raw = self.conv(level, 9, 1, 1, false);
            let scores = self.sliced(raw, 0, 5);
            let scores = self.wire(sigmoid(), &[scores]);
            let sides = self.sliced(raw, 5, 9);
            let all = self.wire(TypedConcat::new(1), &[scores, sides]);
            let shape = self.model.outlet_fact(all).expect("a fact").shape.to_tvec();
            let area = shape[2].clone() * &shape[3];
            let from = tvec!(shape[2].clone(), shape[3].clone());
            self.wire(AxisOp::Reshape(2, from, tvec!(area)), &[all])
        });
        let all = self.wire(TypedConcat::new(2), &rows);
        self.wire(AxisOp::Move(1, 2), &[all])
    }

    fn done(mut self, output: OutletId) -> TypedModel {
        self.model.select_output_outlets(&[output]).expect("an output");
        self.model
    }
}

/// A detector in small: stem, pool, a unit with a shuffle, a sum, two levels. With `between`,
/// an operator that the kernels do not have stands in its middle.
fn detector(kind: Kind, size: [usize; 2], between: bool) -> TypedModel {
    let (mut maker, input) = Maker::new(kind, size);
    let m = &mut maker;
    let stem = m.block(input, 16, 3, 2, false);
    let low = m.pool(stem, 16);
    let mut low = m.block(low, 20, 1, 1, false);
    let skipped = low;
    if between {
        low = m.wire(tanh(), &[low]);
        low = m.rounded(low);
    }
    let left = m.sliced(low, 0, 10);
    let right = m.sliced(low, 10, 20);
    let right = m.block(right, 10, 1, 1, false);
    let right = m.block(right, 10, 3, 1, true);
    let right = m.block(right, 10, 1, 1, false);
    let mixed = m.shuffled(left, right);
    // Across the operator that may stand between.
    let sum = m.wire(add(), &[mixed, skipped]);
    let sum = m.rounded(sum);
    let deep = m.block(sum, 20, 5, 2, true);
    let deep = m.block(deep, 24, 1, 1, false);
    let output = m.head([sum, deep]);
    maker.done(output)
}

fn input(size: [usize; 2]) -> Tensor {
    let values = Random(9).floats(3 * size[0] * size[1]);
    Tensor::from_shape(&[1, 3, size[0], size[1]], &values).expect("a picture")
}

fn state(model: TypedModel) -> TypedSimpleState {
    let model = model.into_optimized().expect("a plan");
    model.into_runnable().expect("a plan").spawn().expect("a state")
}

fn run(state: &mut TypedSimpleState, input: &Tensor) -> Vec<f32> {
    let output = state.run(tvec!(input.clone().into_tvalue())).expect("a run").remove(0);
    let view = output.try_as_plain_ram().expect("memory");
    view.as_slice::<f32>().expect("floats").to_vec()
}

fn subnets(state: &TypedSimpleState) -> usize {
    state.model().nodes().iter().filter(|node| node.op_is::<Subnet>()).count()
}

/// Mean and largest difference.
fn apart(a: &[f32], b: &[f32]) -> (f32, f32) {
    assert_eq!(a.len(), b.len());
    let differences = || a.iter().zip(b).map(|(a, b)| (a - b).abs());
    (differences().sum::<f32>() / a.len() as f32, differences().fold(0.0, f32::max))
}

/// On the kernels as in tract, to `mean` and `most`.
fn assert_agrees(model: &TypedModel, size: [usize; 2], regions: usize, (mean, most): (f32, f32)) {
    let mut ours = model.clone();
    let left = KernelTransform::default().apply(&mut ours).expect("a transform");
    let mut ours = state(ours);
    assert_eq!(subnets(&ours), regions, "{left:?}");
    let input = input(size);
    let expected = run(&mut state(model.clone()), &input);
    for turn in 0..2 {
        let found = run(&mut ours, &input);
        let (a, b) = apart(&found, &expected);
        println!("turn {turn}: mean {a}, most {b}");
        assert!(a <= mean && b <= most, "turn {turn}: mean {a}, most {b}");
    }
}

const SIZE: [usize; 2] = [64, 96];

/// In bytes two programs that sum in another order fall to either side of a step now and then,
/// and what follows carries that on.
const IN_BYTES: (f32, f32) = (0.004, 0.1);

#[test]
fn a_net_of_bytes_is_one_operator_and_agrees() {
    assert_agrees(&detector(Kind::Unsigned, SIZE, false), SIZE, 1, IN_BYTES);
}

#[test]
fn signed_bytes_agree_too() {
    assert_agrees(&detector(Kind::Signed, SIZE, false), SIZE, 1, IN_BYTES);
}

#[test]
fn a_net_of_floats_agrees_to_rounding() {
    assert_agrees(&detector(Kind::Float, SIZE, false), SIZE, 1, (1e-6, 1e-5));
}

#[test]
fn what_is_not_known_stays_between_two_operators() {
    for (kind, apart) in
        [(Kind::Unsigned, IN_BYTES), (Kind::Signed, IN_BYTES), (Kind::Float, (1e-6, 1e-5))]
    {
        let model = detector(kind, SIZE, true);
        assert_agrees(&model, SIZE, 2, apart);
        let left = KernelTransform::default().apply(&mut model.clone()).expect("a transform");
        let operators: Vec<&str> = left.iter().map(|left| &left.operator[..]).collect();
        assert_eq!(operators, ["Tanh"]);
    }
}

#[test]
fn a_net_without_a_convolution_is_left_alone() {
    let (mut maker, input) = Maker::new(Kind::Unsigned, SIZE);
    let pooled = maker.pool(input, 3);
    let mut model = maker.done(pooled);
    let left = KernelTransform::default().apply(&mut model).expect("a transform");
    assert!(left.iter().all(|left| left.reason.contains("too few convolutions")), "{left:?}");
    assert_eq!(subnets(&state(model)), 0);
}

#[test]
fn cells_are_read_in_place_where_their_score_can_count() {
    let mut model = detector(Kind::Unsigned, SIZE, false);
    let input = input(SIZE);
    KernelTransform::default().apply(&mut model).expect("a transform");
    let mut state = state(model);
    let expected = run(&mut state, &input);
    let subnet = state.model().nodes().iter().find_map(|node| node.op_as::<Subnet>());
    let subnet = subnet.expect("one operator").clone();
    let gate = Gate::new(subnet.parts().expect("rows"), &(0..5), 0.6);
    let id = state.model().nodes().iter().position(|node| node.op_is::<Subnet>()).expect("one");
    let memory = state.op_states[id].as_mut().expect("a state");
    let memory = memory.downcast_mut::<SubnetState>().expect("its state");
    let mut seen = 0;
    let all = memory.rows(0, &gate, |cell, row| {
        assert_eq!(row, &expected[cell * 9..][..9]);
        seen += 1;
        std::ops::ControlFlow::<()>::Continue(())
    });
    assert!(all.is_continue());
    let over = expected.chunks(9).filter(|row| row[..5].iter().any(|&s| s >= 0.6)).count();
    assert!(over > 0 && seen >= over && seen < expected.len() / 9, "{over} {seen}");
}

#[test]
fn another_input_size_is_the_model_made_for_it() {
    let large = [96, 160];
    for kind in [Kind::Unsigned, Kind::Float] {
        let asked = with_input_size(&detector(kind, SIZE, false), large).expect("another size");
        let made = detector(kind, large, false);
        let input = input(large);
        let (mean, most) = apart(&run(&mut state(asked), &input), &run(&mut state(made), &input));
        assert!(mean == 0.0 && most == 0.0, "{mean} {most}");
    }
}

#[test]
fn a_constant_of_one_size_is_refused_at_another() {
    let (mut maker, input) = Maker::new(Kind::Float, SIZE);
    let sums = maker.conv(input, 4, 3, 1, false);
    let grid = maker.konst(Tensor::zero::<f32>(&[1, 4, SIZE[0], SIZE[1]]).expect("zeros"));
    let sum = maker.wire(add(), &[sums, grid]);
    let model = maker.done(sum);
    assert!(with_input_size(&model, SIZE).is_ok());
    assert!(with_input_size(&model, [96, 160]).is_err());
}

#[test]
fn without_rounding_a_net_of_bytes_is_near_and_in_floats() {
    let model = detector(Kind::Unsigned, SIZE, false);
    let float = without_rounding(&model).expect("floats");
    let input = input(SIZE);
    let rounded = run(&mut state(model), &input);
    let (mean, most) = apart(&run(&mut state(float.clone()), &input), &rounded);
    // Bytes saturate where floats go on.
    assert!(mean > 0.0 && mean < 0.5, "{mean} {most}");
    assert_agrees(&float, SIZE, 1, (1e-6, 1e-5));
}
