//! Each kernel on every instruction set of this processor, at sizes of the shipped model.
//!
//! `cargo bench -p verge-kernels`

use divan::Bencher;
use verge_kernels::{Builder, Conv, Isa, Net, QuantParams, Shape, Tensor, Weights};

fn main() {
    divan::main();
}

fn names() -> Vec<&'static str> {
    Isa::available().into_iter().map(Isa::name).collect()
}

fn isa(name: &str) -> Isa {
    Isa::available().into_iter().find(|isa| isa.name() == name).unwrap_or(Isa::Portable)
}

const STEPS: Option<QuantParams> = Some(QuantParams { scale: 0.02, zero_point: 100 });

/// Rows, columns, channels.
type Size = [usize; 3];

fn start(name: &str, [height, width, channels]: Size, int8: bool) -> (Builder, Tensor) {
    let shape = Shape { height, width, channels };
    Builder::new(isa(name), shape, if int8 { STEPS } else { None })
}

/// A convolution over `size` with made weights.
fn conv(name: &str, size: Size, channels: usize, kernel: usize, deep: bool, int8: bool) -> Net {
    let (mut builder, input) = start(name, size, int8);
    let count = channels * kernel * kernel * if deep { 1 } else { size[2] };
    let values: Vec<i8> = (0..count).map(|i| (i * 37 % 255) as u8 as i8).collect();
    let floats: Vec<f32> = values.iter().map(|&v| f32::from(v) / 127.0).collect();
    let (scales, bias, zeros) = (vec![0.001; channels], vec![7; channels], vec![0.1; channels]);
    let weights = if int8 {
        Weights::Int8 { values: &values, scales: &scales, bias: &bias }
    } else {
        Weights::Float { values: &floats, bias: &zeros }
    };
    let conv = Conv {
        weights,
        channels,
        kernel,
        stride: if kernel == 3 && !deep { 2 } else { 1 },
        pad: kernel / 2,
        depthwise: deep,
        before: None,
        slope: Some(0.1),
        out: if int8 { STEPS } else { None },
    };
    let out = builder.conv(input, &conv).expect("a kernel");
    done(builder, out)
}

/// Outputs must be floats: one pixel of them, so that the kernel alone is timed.
fn done(mut builder: Builder, out: Tensor) -> Net {
    let channels = builder.shape(out).channels;
    if builder.quant_params(out).is_none() {
        return builder.finish(&[out]).expect("floats").net();
    }
    let small = builder.pool(out, 3, 60, 1).expect("it fits");
    let values = vec![1i8; channels];
    let conv = Conv {
        weights: Weights::Int8 { values: &values, scales: &[1.0], bias: &[0] },
        channels: 1,
        kernel: 1,
        stride: 1,
        pad: 0,
        depthwise: false,
        before: None,
        slope: None,
        out: None,
    };
    let end = builder.conv(small, &conv).expect("a kernel");
    builder.finish(&[end]).expect("floats").net()
}

fn run(bencher: Bencher<'_, '_>, mut net: Net) {
    net.input_bytes(0).fill(90);
    net.input_floats(0).fill(0.5);
    bencher.bench_local(|| net.run());
}

macro_rules! convolutions {
    ($($kind:ident: $size:expr, $channels:expr, $kernel:expr, $deep:expr;)*) => {$(
        mod $kind {
            use super::*;

            #[divan::bench(args = names())]
            fn int8(bencher: Bencher<'_, '_>, name: &str) {
                run(bencher, conv(name, $size, $channels, $kernel, $deep, true));
            }

            #[divan::bench(args = names())]
            fn f32(bencher: Bencher<'_, '_>, name: &str) {
                run(bencher, conv(name, $size, $channels, $kernel, $deep, false));
            }
        }
    )*};
}

convolutions! {
    product_58_to_58: [60, 80, 58], 58, 1, false;
    product_232_to_232: [15, 20, 232], 232, 1, false;
    stem_3_to_24: [480, 640, 3], 24, 3, false;
    depthwise_3x3_58: [60, 80, 58], 58, 3, true;
    depthwise_5x5_96: [60, 80, 96], 96, 5, true;
}

macro_rules! others {
    ($($kind:ident: $size:expr, |$builder:ident, $input:ident| $make:expr;)*) => {$(
        mod $kind {
            use super::*;

            fn net(name: &str, int8: bool) -> Net {
                let (mut $builder, $input) = start(name, $size, int8);
                let out = $make;
                done($builder, out)
            }

            #[divan::bench(args = names())]
            fn int8(bencher: Bencher<'_, '_>, name: &str) {
                run(bencher, net(name, true));
            }

            #[divan::bench(args = names())]
            fn f32(bencher: Bencher<'_, '_>, name: &str) {
                run(bencher, net(name, false));
            }
        }
    )*};
}

others! {
    max_pool_24: [240, 320, 24], |b, input| b.pool(input, 3, 2, 1).expect("it fits");
    shuffle_58: [60, 80, 58], |b, input| b.interleave(input, input).expect("alike");
    add_96: [60, 80, 96], |b, input| {
        let steps = b.quant_params(input);
        b.add(input, input, steps).expect("alike")
    };
    enlarge_96: [30, 40, 96], |b, input| b.double(input);
}
