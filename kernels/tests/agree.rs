//! Every instruction set of this processor against the portable one, and that against plain
//! loops over the definition.

use verge_kernels::{Builder, Conv, Isa, Net, QuantParams, Shape, Tensor, Weights};

/// A small generator with a seed; xorshift.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn bytes(&mut self, n: usize) -> Vec<u8> {
        (0..n).map(|_| (self.next() >> 24) as u8).collect()
    }

    fn weights(&mut self, n: usize) -> Vec<i8> {
        // The extremes too: that is where narrow sums would overflow.
        let one = |v: u8| {
            if v < 40 {
                -127
            } else if v > 215 {
                127
            } else {
                v.cast_signed()
            }
        };
        self.bytes(n).into_iter().map(one).collect()
    }

    fn floats(&mut self, n: usize) -> Vec<f32> {
        self.bytes(n).into_iter().map(|v| f32::from(v) / 64.0 - 2.0).collect()
    }
}

/// Shape of a convolution, without its numbers.
#[derive(Clone, Copy, Debug)]
struct Form {
    channels: usize,
    kernel: usize,
    stride: usize,
    depthwise: bool,
    rounded_before: bool,
    slope: Option<f32>,
    float_out: bool,
}

const ONE: Form = Form {
    channels: 24,
    kernel: 1,
    stride: 1,
    depthwise: false,
    rounded_before: false,
    slope: Some(0.1),
    float_out: false,
};

/// Puts a convolution with made weights behind `input`.
fn conv(builder: &mut Builder, input: Tensor, form: Form, random: &mut Random) -> Tensor {
    let seen = if form.depthwise { 1 } else { builder.shape(input).channels };
    let sums = seen * form.kernel * form.kernel;
    let values = random.weights(form.channels * sums);
    let bias: Vec<i32> =
        random.bytes(form.channels).into_iter().map(|v| (i32::from(v) - 128) * 90).collect();
    let scales: Vec<f32> =
        random.bytes(form.channels).into_iter().map(|v| 0.001 + f32::from(v) * 1e-5).collect();
    let scale = 0.01 * (sums as f32).sqrt();
    let steps = |zero| QuantParams { scale, zero_point: zero };
    let conv = Conv {
        weights: Weights::Int8 { values: &values, scales: &scales, bias: &bias },
        channels: form.channels,
        kernel: form.kernel,
        stride: form.stride,
        pad: form.kernel / 2,
        depthwise: form.depthwise,
        before: form.rounded_before.then(|| steps(140)),
        slope: form.slope,
        out: (!form.float_out).then(|| steps(37)),
    };
    builder.conv(input, &conv).expect("a convolution that is known")
}

fn outputs(net: &mut Net, input: &[u8]) -> Vec<u32> {
    net.input_bytes(0).copy_from_slice(input);
    net.run();
    net.output(0).flatten().map(|v| v.to_bits()).collect()
}

/// A network that uses every kernel, channels and sizes that fill no vector.
fn everything(isa: Isa, seed: u64, [height, width]: [usize; 2]) -> Net {
    let random = &mut Random(seed);
    let shape = Shape { height, width, channels: 3 };
    let (mut b, input) =
        Builder::new(isa, shape, Some(QuantParams { scale: 0.02, zero_point: 114 }));
    let plain = Form { slope: None, ..ONE };
    let stem = conv(&mut b, input, Form { kernel: 3, stride: 2, ..ONE }, random);
    let pooled = b.pool(stem, 3, 2, 1).expect("it fits");
    let deep =
        |channels, kernel, stride| Form { channels, kernel, stride, depthwise: true, ..plain };
    let left = conv(&mut b, pooled, deep(24, 3, 2), random);
    let left = conv(&mut b, left, Form { channels: 29, ..ONE }, random);
    let right = conv(&mut b, pooled, Form { channels: 29, rounded_before: true, ..ONE }, random);
    let right = conv(&mut b, right, deep(29, 3, 2), random);
    let right = conv(&mut b, right, Form { channels: 29, ..ONE }, random);
    let steps = b.quant_params(right).expect("steps");
    let left = b.requantise(left, steps).expect("steps");
    let mixed = b.interleave(left, right).expect("halves");
    let low = b.slice(mixed, 0, 29).expect("half");
    let high = b.slice(mixed, 29, 29).expect("half");
    let high = conv(&mut b, high, deep(29, 5, 1), random);
    let copy = pooled_to(&mut b, low);
    let joined = b.concat(&[low, high, copy], Some(steps)).expect("they fit");
    let wide = conv(&mut b, joined, Form { channels: 131, slope: Some(0.0), ..ONE }, random);
    let back = conv(&mut b, wide, Form { channels: 87, ..plain }, random);
    let sum =
        b.add(joined, back, Some(QuantParams { scale: 0.05, zero_point: 60 })).expect("alike");
    let large = b.double(sum);
    let last = conv(&mut b, large, deep(87, 5, 2), random);
    let end = Form { channels: 38, float_out: true, ..plain };
    let end = conv(&mut b, last, end, random);
    b.finish(&[end]).expect("floats").net()
}

/// A copy in other steps.
fn pooled_to(builder: &mut Builder, from: Tensor) -> Tensor {
    builder.requantise(from, QuantParams { scale: 0.033, zero_point: 9 }).expect("steps")
}

const SIZE: [usize; 2] = [50, 38];

/// Small enough for Miri, which `.ci/run` has look over every pointer where there is one.
#[test]
fn small_networks_keep_to_their_memory() {
    let input = Random(3).bytes(10 * 8 * 3);
    for isa in Isa::available() {
        let mut net = everything(isa, 1, [10, 8]);
        assert_eq!(outputs(&mut net, &input), outputs(&mut net.clone(), &input));
    }
}

#[test]
fn integers_are_the_same_bytes_on_every_instruction_set() {
    let here = Isa::available();
    println!("this processor: {here:?}");
    for seed in [1, 2, 3] {
        let input = Random(seed + 100).bytes(SIZE[0] * SIZE[1] * 3);
        let reference = outputs(&mut everything(Isa::Portable, seed, SIZE), &input);
        assert!(reference.iter().collect::<std::collections::HashSet<_>>().len() > 100);
        for &isa in &here {
            let mut net = everything(isa, seed, SIZE);
            assert_eq!(net.isa(), isa);
            assert!(outputs(&mut net, &input) == reference, "{isa:?}, seed {seed}");
            // Memory that steps share leaves no trace from run to run.
            assert!(outputs(&mut net, &input) == reference, "{isa:?} again, seed {seed}");
        }
    }
}

/// One convolution by its definition, in steps before the output is rounded.
fn by_definition(
    input: &[u8],
    shape: Shape,
    zero: u8,
    form: Form,
    values: &[i8],
    bias: &[i32],
) -> Vec<i32> {
    let (k, pad) = (form.kernel, form.kernel / 2);
    let out = |n: usize| (n + 2 * pad - k) / form.stride + 1;
    let seen = if form.depthwise { 1 } else { shape.channels };
    let mut sums = Vec::new();
    for y in 0..out(shape.height) {
        for x in 0..out(shape.width) {
            for o in 0..form.channels {
                let mut sum = bias[o];
                for (i, &w) in values[o * seen * k * k..][..seen * k * k].iter().enumerate() {
                    let (c, row, column) = (i / (k * k), i / k % k, i % k);
                    let c = if form.depthwise { o } else { c };
                    let (v, u) = (y * form.stride + row, x * form.stride + column);
                    if v < pad || u < pad || v - pad >= shape.height || u - pad >= shape.width {
                        continue;
                    }
                    let pixel = (v - pad) * shape.width + u - pad;
                    let value = i32::from(input[pixel * shape.channels + c]) - i32::from(zero);
                    sum += value * i32::from(w);
                }
                sums.push(sum);
            }
        }
    }
    sums
}

#[test]
fn convolutions_are_their_definition() {
    let mut random = Random(7);
    for (kernel, stride, depthwise) in
        [(1, 1, false), (3, 2, false), (3, 1, true), (3, 2, true), (5, 1, true), (5, 2, true)]
    {
        let shape = Shape { height: 11, width: 14, channels: 19 };
        let channels = if depthwise { 19 } else { 21 };
        let form =
            Form { channels, kernel, stride, depthwise, slope: None, float_out: true, ..ONE };
        let seen = if depthwise { 1 } else { shape.channels };
        let values = random.weights(channels * seen * kernel * kernel);
        let bias: Vec<i32> = random.bytes(channels).into_iter().map(i32::from).collect();
        let input = random.bytes(11 * 14 * 19);
        let expected = by_definition(&input, shape, 77, form, &values, &bias);
        for isa in Isa::available() {
            let steps = QuantParams { scale: 1.0, zero_point: 77 };
            let (mut builder, start) = Builder::new(isa, shape, Some(steps));
            let conv = Conv {
                weights: Weights::Int8 {
                    values: &values,
                    scales: &[1.0; 21][..channels],
                    bias: &bias,
                },
                channels,
                kernel,
                stride,
                pad: kernel / 2,
                depthwise,
                before: None,
                slope: None,
                out: None,
            };
            let end = builder.conv(start, &conv).expect("known");
            let mut net = builder.finish(&[end]).expect("floats").net();
            net.input_bytes(0).copy_from_slice(&input);
            net.run();
            let found: Vec<i32> = net.output(0).flatten().map(|&v| v as i32).collect();
            assert_eq!(found, expected, "{isa:?} {form:?}");
        }
    }
}

#[test]
fn floats_agree_to_rounding() {
    let run = |isa: Isa| {
        let mut random = Random(11);
        let shape = Shape { height: 30, width: 22, channels: 3 };
        let (mut b, input) = Builder::new(isa, shape, None);
        let mut conv = |b: &mut Builder, from, channels, kernel, stride, depthwise| {
            let seen = if depthwise { 1 } else { b.shape(from).channels };
            let values = random.floats(channels * seen * kernel * kernel);
            let factor = 0.5 / ((seen * kernel * kernel) as f32).sqrt();
            let values: Vec<f32> = values.into_iter().map(|v| v * factor).collect();
            let bias = random.floats(channels);
            let weights = Weights::Float { values: &values, bias: &bias };
            let (pad, slope) = (kernel / 2, Some(0.1));
            let conv = Conv {
                weights,
                channels,
                kernel,
                stride,
                pad,
                depthwise,
                before: None,
                slope,
                out: None,
            };
            b.conv(from, &conv).expect("known")
        };
        let stem = conv(&mut b, input, 26, 3, 2, false);
        let pooled = b.pool(stem, 3, 2, 1).expect("fits");
        let a = conv(&mut b, pooled, 26, 3, 1, true);
        let c = conv(&mut b, pooled, 26, 5, 1, true);
        let mixed = b.interleave(a, c).expect("alike");
        let sum = b.add(a, c, None).expect("alike");
        let joined = b.concat(&[mixed, sum], None).expect("alike");
        let large = b.double(joined);
        let end = conv(&mut b, large, 70, 1, 1, false);
        let mut net = b.finish(&[end]).expect("floats").net();
        let picture = Random(5).floats(30 * 22 * 3);
        net.input_floats(0).copy_from_slice(&picture);
        net.run();
        net.output(0).flatten().copied().collect::<Vec<f32>>()
    };
    let reference = run(Isa::Portable);
    for isa in Isa::available() {
        for (a, b) in run(isa).iter().zip(&reference) {
            assert!((a - b).abs() <= 2e-5 * b.abs().max(1.0), "{isa:?}: {a} for {b}");
        }
    }
}

#[test]
fn what_there_is_no_kernel_for_is_refused() {
    let shape = Shape { height: 8, width: 8, channels: 4 };
    let (mut builder, input) =
        Builder::new(Isa::best(), shape, Some(QuantParams { scale: 1.0, zero_point: 0 }));
    let error = builder.slice(input, 2, 3).expect_err("too many channels").to_string();
    assert!(error.contains("2 to 5 of 4"), "{error}");
    let weights = Weights::Float { values: &[0.0; 16], bias: &[0.0; 4] };
    let conv = Conv {
        weights,
        channels: 4,
        kernel: 1,
        stride: 1,
        pad: 0,
        depthwise: false,
        before: None,
        slope: None,
        out: None,
    };
    let error = builder.conv(input, &conv).expect_err("floats on bytes").to_string();
    assert!(error.contains("another kind"), "{error}");
    let error = builder.finish(&[]).expect_err("nothing to give out").to_string();
    assert!(error.contains("without an output"), "{error}");
}
