//! Times a training step and inference of the network that reads all that is given: `cargo run --release -p renderflow-model --example fusion_time`.

use rand::RngExt;
use renderflow_model::data::step_rng;
use renderflow_model::fusion::batch::TIERS;
use renderflow_model::fusion::record::{Chosen, NEIGHBOURS, PARTS, Record, at};
use renderflow_model::fusion::{Fusion, FusionConfig};
use renderflow_model::parameters;
use std::time::Instant;

fn main() {
    let config = FusionConfig::default();
    let network = Fusion::untrained(&config, 1).expect("the default configuration is valid");
    let count: usize = network.parameters().iter().map(|p: &parameters::Parameter| p.values.len()).sum();
    println!("{count} parameters, {} threads", rayon::current_num_threads());
    for size in [256, 512] {
        let record = record(size);
        for tier in TIERS {
            let chosen = Chosen { groups: tier.groups, ..Chosen::all(&record) };
            let mut seconds: Vec<f64> = (0..9)
                .map(|_| {
                    let start = Instant::now();
                    network.draw(&record, &chosen).expect("a picture");
                    start.elapsed().as_secs_f64()
                })
                .collect();
            seconds.sort_by(f64::total_cmp);
            println!("{size} x {size}, {}: {:.0} ms (median of 9; least {:.0})", tier.name, 1e3 * seconds[4], 1e3 * seconds[0]);
        }
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
    (record.parts, record.neighbours) = ([2; PARTS], [2; NEIGHBOURS]);
    record
}
