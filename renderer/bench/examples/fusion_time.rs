//! Times training steps and inference of the network that reads samples, with the shares of the head and of the batches, which
//! are made beside the steps: `cargo run --release -p renderflow-bench --example fusion_time`. Of the two times in bf16, the
//! first is without the matrix unit. An argument is the configuration of the network in JSON.

use burn::tensor::Device;
use rand::RngExt;
use renderflow_model::data::step_rng;
use renderflow_model::fusion::batch::{Batch, TIERS};
use renderflow_model::fusion::loss::{LossWeights, Truth, loss};
use renderflow_model::fusion::record::{NEIGHBOURS, PARTS, PICTURES, Record, Selection, at};
use renderflow_model::fusion::training::FusionObjective;
use renderflow_model::fusion::{Fusion, FusionConfig, FusionNet, head};
use renderflow_model::kernels::{Choice, force};
use renderflow_model::ops::Products;
use renderflow_model::parameters;
use renderflow_model::train::optimizer::Optimizer;
use renderflow_model::train::runner::Objective;
use renderflow_model::train::sequences::Crop;
use renderflow_model::train::{Method, RunConfig, Share};
use std::time::Instant;

const CROP: usize = 96;
const ITEMS: usize = 8;
/// Ways to multiply: in f32, in bf16 by vectors, and in bf16 by the matrix unit if the processor has one.
const WAYS: [(Products, Choice); 3] =
    [(Products::F32, Choice::Automatic), (Products::Bf16, Choice::Avx512), (Products::Bf16, Choice::Automatic)];

fn main() {
    let config = match std::env::args().nth(1) {
        Some(json) => serde_json::from_str(&json).expect("a configuration in JSON"),
        None => FusionConfig::default(),
    };
    let network = Fusion::untrained(&config, 1).expect("the default configuration is valid");
    let count: usize = network.parameters().iter().map(|p: &parameters::Parameter| p.values.len()).sum();
    println!("{count} parameters, {} threads", rayon::current_num_threads());
    let device = Device::flex().autodiff();
    let model = FusionNet::new(&config, 1, &device).expect("the default configuration is valid");
    let frame = record(256).to_half();
    let crop = Crop { size: CROP, batch: ITEMS, from: 0.0 };
    for tier in TIERS {
        let mut rng = step_rng(1, 1);
        let mut drawn = || Batch::draw(&[&frame], &[tier], crop, Share::WHOLE, &mut rng).expect("the record has everything");
        let batch = median(|| drop(drawn()));
        let one = drawn();
        let head = median(|| head_alone(&one));
        let [step, vectors, matrices] = WAYS.map(|(products, choice)| {
            force(choice);
            let mut batches: Vec<Batch> = (0..9).map(|_| drawn()).collect();
            let objective = FusionObjective { products, ..FusionObjective::default() };
            median(|| {
                let batch = batches.pop().expect("a batch for each run");
                objective.step(&model, batch, &device).expect("the batch fits");
            })
        });
        println!(
            "{}, {ITEMS} crops of {CROP}: batch {batch:.0} ms, step {step:.0} ms, in bf16 {vectors:.0} and {matrices:.0}, \
                head {head:.0} ms",
            tier.name
        );
    }
    for method in [Method::AdamW, Method::Muon] {
        let mut optimizer = Optimizer::new(parameters::export_learning(&model));
        let gradients: Vec<Option<Vec<f32>>> = optimizer.values().iter().map(|values| Some(values.to_vec())).collect();
        let run = RunConfig { optimizer: method, ..RunConfig::default() };
        let step = median(|| drop(optimizer.step(&gradients, 1e-4, &run)));
        println!("{method:?}: {step:.0} ms");
    }
    for size in [256, 512] {
        let record = record(size);
        for tier in TIERS {
            let selection = Selection { groups: tier.groups, ..Selection::all(&record) };
            let [seconds, vectors, matrices] = WAYS.map(|(products, choice)| {
                force(choice);
                let network = network.clone().with_products(products);
                median(|| drop(network.draw(&record, &selection)))
            });
            println!("{size} x {size}, {}: {seconds:.0} ms, in bf16 {vectors:.0} and {matrices:.0}", tier.name);
        }
    }
}

/// Milliseconds, the median of nine runs.
fn median(mut f: impl FnMut()) -> f64 {
    let milliseconds = |_| {
        let start = Instant::now();
        f();
        1e3 * start.elapsed().as_secs_f64()
    };
    renderflow::metrics::median(&(0..9).map(milliseconds).collect::<Vec<f64>>())
}

/// The head forwards and backwards on outputs of 0.
fn head_alone(batch: &Batch) {
    let pixels = batch.width * batch.height;
    let fine = vec![0.0; batch.items * pixels / 4 * head::fine(batch.groups)];
    let coarse = vec![0.0; if batch.groups.samples { batch.items * pixels / 16 * head::KERNEL } else { 0 }];
    for item in 0..batch.items {
        let picture = batch.picture(item, &fine, &coarse);
        let (drawn, tape) = picture.draw();
        let range = item * pixels..(item + 1) * pixels;
        let truth = Truth { picture: &batch.truth[range.clone()], raw: &batch.raw[range] };
        let (_, slopes) = loss(batch.width, picture.pixels, &drawn, truth, LossWeights::default());
        picture.backward(&tape, &slopes);
    }
}

/// Numbers between 0 and 1 in every group.
fn record(size: usize) -> Record<f32> {
    let mut rng = step_rng(1, 0);
    let mut record = Record::new(size, size);
    record.pixels.iter_mut().for_each(|v| *v = rng.random());
    record.pixels.chunks_exact_mut(at::COUNT).for_each(|stored| stored[at::ALPHA] = 1.0);
    record.deferred = true;
    record.distances = [Some(-8.0), Some(8.0)];
    (record.parts, record.neighbours, record.denoised) = ([2; PARTS], [2; NEIGHBOURS], [true; PICTURES]);
    record.paths = true;
    record
}
