//! The convolution kernels against burn's own operations, against each other, and against values that JAX computed in f64.
use burn::tensor::{Device, Tensor, TensorData};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use renderflow_model::kernels::{Choice, force};
use renderflow_model::ops::{self, Products, Stride};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, Mutex, MutexGuard};

/// `force` acts on the whole process, so tests take turns, each beginning with the kernel that users get.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    let turn = TURN.lock().unwrap_or_else(|e| e.into_inner());
    force(Choice::Automatic);
    turn
}

/// Whether noise is made of numbers that bf16 holds exactly, and sums of four of them too.
static COARSE: AtomicBool = AtomicBool::new(false);

fn noise(rng: &mut Pcg64Mcg, count: usize) -> Vec<f32> {
    let coarse = COARSE.load(Ordering::Relaxed);
    let number = |v: f32| if coarse { (64.0 * v).round() / 64.0 } else { v };
    (0..count).map(|_| number(rng.random_range(-1.0..1.0))).collect()
}

/// One operation with its sizes: everything a run needs, made from a seed.
#[derive(Clone, Copy, Debug)]
enum Case {
    Conv { batch: usize, height: usize, width: usize, inputs: usize, outputs: usize, kernel: usize, stride: Stride, silu: bool },
    Decode { batch: usize, height: usize, width: usize, up: usize, skip: usize, outputs: usize },
    Linear { batch: usize, tokens: usize, inputs: usize, outputs: usize, silu: bool },
    Attention { batch: usize, queries: usize, keys: usize, channels: usize, heads: usize },
    Norm { pixels: usize, channels: usize, silu: bool },
    Rms { batch: usize, tokens: usize, channels: usize },
    Modulate { batch: usize, tokens: usize, groups: usize, channels: usize, eps: Option<f32> },
    Gate { batch: usize, tokens: usize, channels: usize },
    Turn { batch: usize, tokens: usize, heads: usize, pairs: usize },
    Gelu { count: usize },
    Time { batch: usize, frames: usize, side: usize, inputs: usize, outputs: usize, kernel: usize, step: usize, newest: usize },
}

/// Output and the gradient of every input, in order.
type Results = Vec<Vec<f32>>;

fn tensor<const D: usize>(rng: &mut Pcg64Mcg, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(noise(rng, shape.iter().product()), shape), device)
}

fn leaf<const D: usize>(rng: &mut Pcg64Mcg, shape: [usize; D], device: &Device) -> Tensor<D> {
    tensor(rng, shape, device).require_grad()
}

fn floats<const D: usize>(t: Tensor<D>) -> Vec<f32> {
    t.into_data().try_to_vec().expect("floats")
}

/// Weighs the output with fixed noise, so that every output element has another gradient.
fn gradients<const D: usize>(rng: &mut Pcg64Mcg, y: Tensor<D>, device: &Device) -> burn::tensor::Gradients {
    let weights = tensor(rng, y.dims(), device);
    (y * weights).sum().backward()
}

fn run(case: Case) -> Results {
    run_by(Products::F32, case)
}

fn run_by(products: Products, case: Case) -> Results {
    run_on(&Device::flex(), products, case)
}

fn run_on(device: &Device, products: Products, case: Case) -> Results {
    let device = device.clone().autodiff();
    let rng = &mut Pcg64Mcg::seed_from_u64(7);
    macro_rules! collect {
        ($y:expr, $($input:ident),+) => {{
            let y = $y;
            let found = gradients(rng, y.clone(), &device);
            vec![floats(y.inner()), $(floats($input.grad(&found).expect("gradient"))),+]
        }};
    }
    match case {
        Case::Conv { batch, height, width, inputs, outputs, kernel, stride, silu } => {
            let x = leaf(rng, [batch, height, width, inputs], &device);
            let w = leaf(rng, [kernel, kernel, inputs, outputs], &device);
            let b = leaf(rng, [outputs], &device);
            collect!(ops::conv_by(products, x.clone(), w.clone(), b.clone(), stride, silu), x, w, b)
        }
        Case::Decode { batch, height, width, up, skip, outputs } => {
            let x = leaf(rng, [batch, height, width, up], &device);
            let s = leaf(rng, [batch, 2 * height, 2 * width, skip], &device);
            let w = leaf(rng, [3, 3, up + skip, outputs], &device);
            let b = leaf(rng, [outputs], &device);
            collect!(ops::decode(products, x.clone(), s.clone(), w.clone(), b.clone()), x, s, w, b)
        }
        Case::Linear { batch, tokens, inputs, outputs, silu } => {
            let x = leaf(rng, [batch, tokens, inputs], &device);
            let w = leaf(rng, [inputs, outputs], &device);
            let b = leaf(rng, [outputs], &device);
            collect!(ops::linear(x.clone(), w.clone(), b.clone(), silu), x, w, b)
        }
        Case::Attention { batch, queries, keys, channels, heads } => {
            let q = leaf(rng, [batch, queries, channels], &device);
            let k = leaf(rng, [batch, keys, channels], &device);
            let v = leaf(rng, [batch, keys, channels], &device);
            collect!(ops::attention(q.clone(), k.clone(), v.clone(), heads), q, k, v)
        }
        Case::Norm { pixels, channels, silu } => {
            let x = leaf(rng, [1, 1, pixels, 1, channels], &device);
            let gamma = leaf(rng, [channels], &device);
            collect!(ops::channel_norm(x.clone(), gamma.clone(), silu), x, gamma)
        }
        Case::Rms { batch, tokens, channels } => {
            let (x, gamma) = (leaf(rng, [batch, tokens, channels], &device), leaf(rng, [channels], &device));
            collect!(ops::rms_norm(x.clone(), gamma.clone(), 0.01), x, gamma)
        }
        Case::Modulate { batch, tokens, groups, channels, eps } => {
            let x = leaf(rng, [batch, tokens, channels], &device);
            let [factor, shift] = [(); 2].map(|()| leaf(rng, [batch, groups, channels], &device));
            collect!(ops::modulate(x.clone(), factor.clone(), shift.clone(), eps), x, factor, shift)
        }
        Case::Gate { batch, tokens, channels } => {
            let [x, y] = [(); 2].map(|()| leaf(rng, [batch, tokens, channels], &device));
            let gate = leaf(rng, [batch, 1, channels], &device);
            collect!(ops::gate(x.clone(), y.clone(), gate.clone()), x, y, gate)
        }
        Case::Turn { batch, tokens, heads, pairs } => {
            let x = leaf(rng, [batch, tokens, 2 * heads * pairs], &device);
            let [cos, sin] = [(); 2].map(|()| tensor(rng, [tokens, pairs], &device));
            collect!(ops::turn(x.clone(), cos, sin), x)
        }
        Case::Gelu { count } => {
            // To where one side is 0 and the other the value itself.
            let x = leaf(rng, [count], &device);
            collect!(ops::gelu(x.clone().mul_scalar(12.0)), x)
        }
        Case::Time { batch, frames, side, inputs, outputs, kernel, step, newest } => {
            let x = leaf(rng, [batch, frames, side, side + 2, inputs], &device);
            let w = leaf(rng, [kernel, kernel, 3, inputs, outputs], &device);
            let b = leaf(rng, [outputs], &device);
            collect!(ops::conv_over_time(x.clone(), w.clone(), b.clone(), step, newest), x, w, b)
        }
    }
}

/// On a single thread: cases this small would spend their time waiting for one another on a busy machine.
fn run_with(choice: Choice, case: Case) -> Option<Results> {
    static POOL: LazyLock<rayon::ThreadPool> = LazyLock::new(|| with_threads(1));
    force(choice).then(|| POOL.install(|| run(case)))
}

fn with_threads(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads")
}

fn cases() -> Vec<Case> {
    let mut cases = vec![];
    let shapes = [
        // batch, height, width, inputs, outputs
        (1, 1, 1, 1, 1),
        (1, 1, 1, 3, 17),
        (2, 1, 7, 5, 7),
        (1, 9, 1, 16, 16),
        (2, 2, 3, 33, 31),
        (1, 9, 9, 5, 7),
        (3, 5, 13, 12, 48),
        (1, 16, 16, 88, 12),
        (2, 17, 33, 32, 40),
        (1, 3, 211, 4, 33),
        (1, 20, 24, 70, 64),
    ];
    for (i, (batch, height, width, inputs, outputs)) in shapes.into_iter().enumerate() {
        for kernel in [1, 3] {
            for stride in [Stride::One, Stride::Two, Stride::Up] {
                let silu = (i + kernel / 2) % 2 == 0;
                cases.push(Case::Conv { batch, height, width, inputs, outputs, kernel, stride, silu });
            }
        }
        if height.min(width) > 1 {
            let stride = Stride::Half;
            cases.push(Case::Conv { batch, height, width, inputs, outputs, kernel: 3, stride, silu: i % 2 == 0 });
        }
        cases.push(Case::Decode { batch, height, width, up: inputs, skip: outputs.div_ceil(2), outputs });
        cases.push(Case::Linear { batch, tokens: height * width, inputs, outputs, silu: i % 2 == 0 });
    }
    for (batch, queries, keys, heads, width) in
        [(1, 1, 1, 1, 1), (2, 5, 7, 2, 3), (1, 33, 17, 3, 16), (2, 64, 40, 2, 32), (1, 40, 70, 1, 48)]
    {
        cases.push(Case::Attention { batch, queries, keys, channels: heads * width, heads });
    }
    for (batch, tokens, groups, channels) in
        [(1, 1, 1, 1), (2, 6, 1, 5), (3, 12, 3, 16), (1, 257, 1, 33), (2, 40, 2, 320), (1, 3, 1, 5000)]
    {
        cases.extend([None, Some(0.01)].map(|eps| Case::Modulate { batch, tokens, groups, channels, eps }));
        cases.extend([Case::Rms { batch, tokens, channels }, Case::Gate { batch, tokens, channels }]);
        cases.push(Case::Turn { batch, tokens, heads: groups, pairs: channels });
        cases.push(Case::Gelu { count: tokens * channels });
    }
    // Stills, clips with no, one and two frames of history, every second and third frame; one frame that meets nothing.
    for (batch, frames, side, inputs, outputs, step, newest) in [
        (1, 1, 1, 1, 1, 1, 0),
        (3, 1, 6, 5, 17, 1, 0),
        (2, 5, 4, 16, 24, 1, 0),
        (1, 3, 9, 3, 33, 1, 1),
        (2, 6, 5, 33, 7, 1, 2),
        (2, 5, 4, 12, 16, 2, 2),
        (1, 8, 3, 7, 20, 3, 1),
        (1, 7, 14, 20, 3, 2, 6),
    ] {
        cases.extend([1, 3].map(|kernel| Case::Time { batch, frames, side, inputs, outputs, kernel, step, newest }));
    }
    for (pixels, channels) in [(1, 2), (7, 3), (300, 16), (33, 31), (5, 384), (2, 5000)] {
        cases.extend([false, true].map(|silu| Case::Norm { pixels, channels, silu }));
    }
    cases
}

/// Largest difference, relative to the largest value.
fn difference(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(0.0_f32, |m, v| m.max(v.abs())).max(1e-6);
    found.iter().zip(expected).fold(0.0_f32, |m, (f, e)| {
        assert!(f.is_finite());
        m.max((f - e).abs())
    }) / scale
}

#[test]
fn kernels_equal_the_composition_of_burn_operations() {
    let _turn = alone();
    let mut worst = 0.0_f32;
    for case in cases() {
        let expected = run_with(Choice::Composed, case).expect("always there");
        for choice in [Choice::Avx512, Choice::Avx2, Choice::Scalar] {
            let Some(found) = run_with(choice, case) else {
                println!("{choice:?}: not on this processor");
                continue;
            };
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let difference = difference(found, expected);
                assert!(difference < 1e-5, "{choice:?} {case:?}: result {i} differs by {difference:e}");
                worst = worst.max(difference);
            }
        }
    }
    println!("largest relative difference {worst:e}");
}

/// What a build for GPUs computes, on software where there is none.
#[cfg(feature = "vulkan")]
#[test]
fn gpus_compute_the_same() {
    use renderflow_model::device::NetworkDevice;
    let _turn = alone();
    let device = match NetworkDevice::open("opengl".parse().expect("a choice")) {
        Ok(device) => device,
        Err(error) => return println!("skipped: {error}"),
    };
    for case in cases() {
        let (found, expected) = (run_on(device.device(), Products::F32, case), run(case));
        for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let difference = difference(found, expected);
            assert!(difference < 1e-4, "{case:?}, result {i}: {difference} on {device}");
        }
    }
}

#[test]
fn instruction_sets_agree_bit_for_bit() {
    let _turn = alone();
    for case in cases() {
        let expected = run_with(Choice::Scalar, case);
        for choice in [Choice::Avx2, Choice::Avx512] {
            let Some(found) = run_with(choice, case) else { continue };
            assert!(Some(found) == expected, "{choice:?} {case:?}");
        }
    }
}

/// With numbers that bf16 holds exactly, its products are those of f32; with others they are as far from them as rounding
/// explains. This holds for the matrix unit, if the processor has one, and for vectors.
#[test]
fn products_in_bf16_are_those_of_rounded_factors() {
    let _turn = alone();
    let even = |case: &Case| match *case {
        Case::Conv { inputs, outputs, .. } => inputs % 2 + outputs % 2 == 0,
        Case::Decode { up, skip, outputs, .. } => up % 2 + skip % 2 + outputs % 2 == 0,
        _ => false,
    };
    let mut cases: Vec<Case> = cases().into_iter().filter(even).collect();
    for stride in [Stride::One, Stride::Two, Stride::Up] {
        cases.push(Case::Conv { batch: 2, height: 24, width: 24, inputs: 48, outputs: 64, kernel: 3, stride, silu: false });
    }
    let (mut differ, mut worst) = (0, 0.0_f32);
    let choices = [Choice::Automatic, Choice::Avx512].into_iter().filter(|choice| force(*choice));
    for (case, choice) in choices.flat_map(|choice| cases.iter().map(move |case| (case, choice))) {
        for coarse in [true, false] {
            COARSE.store(coarse, Ordering::Relaxed);
            let exact = coarse && !matches!(case, Case::Decode { .. } | Case::Conv { silu: true, .. });
            force(choice);
            let (found, expected) = (run_by(Products::Bf16, *case), run(*case));
            differ += usize::from(found != expected);
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let difference = difference(found, expected);
                // Rounding errs by 2^-9 of each factor at most.
                let bound = if exact { 1e-5 } else { 0.01 };
                assert!(difference < bound, "{choice:?} {case:?}: result {i} differs by {difference:e}");
                worst = worst.max(difference);
            }
        }
    }
    COARSE.store(false, Ordering::Relaxed);
    println!("{} cases, {differ} runs differ, largest relative difference {worst:e}", cases.len());
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let _turn = alone();
    let large = [
        Case::Conv { batch: 2, height: 40, width: 64, inputs: 48, outputs: 64, kernel: 3, stride: Stride::One, silu: true },
        Case::Conv { batch: 1, height: 65, width: 63, inputs: 32, outputs: 64, kernel: 3, stride: Stride::Two, silu: false },
        Case::Decode { batch: 2, height: 24, width: 20, up: 64, skip: 32, outputs: 32 },
        Case::Linear { batch: 2, tokens: 1024, inputs: 96, outputs: 160, silu: true },
        Case::Attention { batch: 2, queries: 256, keys: 160, channels: 128, heads: 4 },
        Case::Norm { pixels: 3000, channels: 48, silu: true },
        Case::Time { batch: 2, frames: 5, side: 30, inputs: 40, outputs: 64, kernel: 3, step: 1, newest: 1 },
        Case::Modulate { batch: 3, tokens: 256, groups: 2, channels: 96, eps: Some(1e-6) },
        Case::Rms { batch: 3, tokens: 256, channels: 96 },
        Case::Gate { batch: 3, tokens: 256, channels: 96 },
    ];
    let (one, more) = (with_threads(1), [3, 16].map(with_threads));
    for case in large.into_iter().chain(cases().into_iter().step_by(5)) {
        for products in [Products::F32, Products::Bf16] {
            let expected = one.install(|| run_by(products, case));
            for pool in &more {
                let found = pool.install(|| run_by(products, case));
                assert!(found == expected, "{products:?} {case:?} with {} threads", pool.current_num_threads());
            }
        }
    }
}

/// The generator of references/convolution.py.
struct Numbers(u64);

impl Numbers {
    fn take(&mut self, count: usize) -> Vec<f32> {
        let next = |_| {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 57) as f32 - 64.0) / 64.0
        };
        (0..count).map(next).collect()
    }

    fn tensor<const D: usize>(&mut self, shape: &serde_json::Value, device: &Device) -> Tensor<D> {
        let shape: Vec<usize> = serde_json::from_value(shape.clone()).expect("shape");
        let shape: [usize; D] = shape.try_into().expect("dimensions");
        Tensor::from_data(TensorData::new(self.take(shape.iter().product()), shape), device).require_grad()
    }

    /// Largest difference from a stored summary, relative to its largest element (for the sum, times the root of the count).
    fn difference(&mut self, found: &[f32], expected: &serde_json::Value) -> f64 {
        let some: Vec<f64> = serde_json::from_value(expected["some"].clone()).expect("elements");
        let scale = some.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let step = (found.len() / 8).max(1);
        let elements = found.iter().step_by(step).zip(&some).map(|(f, e)| (f64::from(*f) - e).abs()).fold(0.0, f64::max);
        let sum: f64 = found.iter().zip(self.take(found.len())).map(|(f, w)| f64::from(*f) * f64::from(w)).sum();
        let sum = (sum - expected["sum"].as_f64().expect("sum")).abs() / (found.len() as f64).sqrt();
        elements.max(sum) / scale
    }
}

#[test]
fn results_equal_those_of_jax_in_double_precision() {
    let _turn = alone();
    let reference: serde_json::Value = serde_json::from_str(include_str!("references/convolution.json")).expect("reference");
    let device = Device::flex().autodiff();
    let mut worst = 0.0_f64;
    for choice in [Choice::Automatic, Choice::Composed, Choice::Scalar, Choice::Avx2, Choice::Avx512] {
        if !force(choice) {
            continue;
        }
        for case in reference["cases"].as_array().expect("cases") {
            let (name, shapes) = (case["name"].as_str().expect("name"), &case["shapes"]);
            let numbers = &mut Numbers(1);
            macro_rules! compare {
                ($y:expr, $($input:ident),+) => {{
                    let y = $y;
                    let weights = Tensor::from_data(TensorData::new(numbers.take(y.dims().iter().product()), y.dims()), &device);
                    let found = (y.clone() * weights).sum().backward();
                    let mut difference = numbers.difference(&floats(y.inner()), &case["output"]);
                    let mut gradients = case["gradients"].as_array().expect("gradients").iter();
                    $(
                        let gradient = floats($input.grad(&found).expect("gradient"));
                        difference = difference.max(numbers.difference(&gradient, gradients.next().expect("stored")));
                    )+
                    assert!(difference < 1e-5, "{choice:?} {name}: {difference:e}");
                    worst = worst.max(difference);
                }};
            }
            let words: Vec<&str> = name.split(' ').collect();
            match words[..] {
                ["conv", _, stride, finish] => {
                    let (x, w) = (numbers.tensor(&shapes[0], &device), numbers.tensor(&shapes[1], &device));
                    let b = numbers.tensor(&shapes[2], &device);
                    let stride = [("one", Stride::One), ("two", Stride::Two), ("up", Stride::Up)]
                        .into_iter()
                        .find_map(|(name, value)| (name == stride).then_some(value))
                        .expect("stride");
                    compare!(ops::conv(x.clone(), w.clone(), b.clone(), stride, finish == "silu"), x, w, b);
                }
                ["decode"] => {
                    let (x, s) = (numbers.tensor(&shapes[0], &device), numbers.tensor(&shapes[1], &device));
                    let (w, b) = (numbers.tensor(&shapes[2], &device), numbers.tensor(&shapes[3], &device));
                    compare!(ops::decode(Products::F32, x.clone(), s.clone(), w.clone(), b.clone()), x, s, w, b);
                }
                ["linear"] => {
                    let (x, w) = (numbers.tensor(&shapes[0], &device), numbers.tensor(&shapes[1], &device));
                    let b = numbers.tensor(&shapes[2], &device);
                    compare!(ops::linear(x.clone(), w.clone(), b.clone(), true), x, w, b);
                }
                ["attention", heads] => {
                    let (q, k) = (numbers.tensor(&shapes[0], &device), numbers.tensor(&shapes[1], &device));
                    let v = numbers.tensor(&shapes[2], &device);
                    compare!(ops::attention(q.clone(), k.clone(), v.clone(), heads.parse().expect("heads")), q, k, v);
                }
                _ => panic!("unknown case {name}"),
            }
        }
    }
    println!("largest relative difference {worst:e}");
}

#[test]
fn views_are_read_like_copies() {
    let _turn = alone();
    let device = Device::flex();
    let rng = &mut Pcg64Mcg::seed_from_u64(3);
    let (wide, w) = (tensor(rng, [2, 7, 9, 20], &device), tensor(rng, [3, 3, 16, 8], &device));
    let b = Tensor::<1>::zeros([8], &device);
    let part = wide.slice([0..2, 1..6, 2..9, 3..19]);
    let copy = Tensor::from_data(part.clone().into_data(), &device);
    let of = |x: Tensor<4>| floats(ops::conv(x, w.clone(), b.clone(), Stride::One, true));
    assert_eq!(of(part.clone()), of(copy.clone()));
    assert_eq!(of(part.swap_dims(1, 2)), of(copy.swap_dims(1, 2)));
}

#[test]
fn only_wanted_gradients_are_formed() {
    let _turn = alone();
    let device = Device::flex().autodiff();
    let rng = &mut Pcg64Mcg::seed_from_u64(5);
    let (x, skip) = (tensor(rng, [1, 4, 4, 8], &device), tensor(rng, [1, 8, 8, 4], &device));
    let w = tensor(rng, [3, 3, 12, 8], &device);
    let b = leaf(rng, [8], &device);
    let y = ops::decode(Products::F32, x.clone(), skip, w.clone(), b.clone());
    let found = gradients(rng, y, &device);
    assert!(x.grad(&found).is_none() && w.grad(&found).is_none());
    assert_eq!(b.grad(&found).expect("gradient").dims(), [8]);
}

#[test]
fn empty_pictures_and_batches_pass_through() {
    let _turn = alone();
    let device = Device::flex();
    let (w, b) = (Tensor::<4>::zeros([3, 3, 4, 8], &device), Tensor::<1>::zeros([8], &device));
    for shape in [[0, 4, 4, 4], [1, 0, 4, 4], [1, 4, 0, 4]] {
        let y = ops::conv(Tensor::zeros(shape, &device), w.clone(), b.clone(), Stride::One, true);
        assert_eq!(y.dims(), [shape[0], shape[1], shape[2], 8]);
    }
}

#[test]
fn extreme_values_stay_what_silu_makes_of_them() {
    let _turn = alone();
    let device = Device::flex();
    let values = [0.0, -0.0, 1e-30, 20.0, -20.0, 88.0, -88.0, 1e30, -1e30, f32::MAX, f32::MIN];
    let x = Tensor::<3>::from_data(TensorData::new(values.to_vec(), [1, values.len(), 1]), &device);
    let one = Tensor::<2>::ones([1, 1], &device);
    let y = floats(ops::linear(x, one, Tensor::zeros([1], &device), true));
    for (y, v) in y.iter().zip(values) {
        let expected = f64::from(v) / (1.0 + (-f64::from(v)).exp());
        // Below -87 the result is a denormal or less; a large negative input times e^-87 remains small against it.
        let tolerance = 3e-7 * expected.abs() + 2e-38 * f64::from(v).abs();
        assert!((f64::from(*y) - expected).abs() <= tolerance, "silu({v}) = {y}, expected {expected}");
    }
}
