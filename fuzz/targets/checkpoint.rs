//! Checkpoints of a training run: inputs as they are, and as the header (before a NUL) and the tensors of a file whose lengths
//! are right.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, folder, names_file, put, same_again, watch};
use renderflow_model::fusion::training::Config;
use renderflow_model::parameters::Parameter;
use renderflow_model::train::RunConfig;
use renderflow_model::train::checkpoint::{self, CheckpointHeader};
use renderflow_model::train::optimizer::Optimizer;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

fn fresh() -> Optimizer {
    let parameter = |name: &str, shape: &[usize]| {
        let values = (0..shape.iter().product()).map(|i: usize| i as f32).collect();
        Parameter { name: name.into(), shape: shape.into(), values }
    };
    Optimizer::new(vec![parameter("layer.weight", &[2, 2]), parameter("layer.bias", &[2])])
}

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        check(bytes);
        if let Some(bytes) = whole(bytes) {
            check(&bytes);
        }
    })
);

fn check(bytes: &[u8]) {
    let path = FOLDER.join("checkpoint.safetensors");
    put(&path, bytes);
    let mut optimizer = fresh();
    let header = match checkpoint::load::<Config>(&path, &|_| None, None, &mut optimizer) {
        Ok(header) => header.expect("the checkpoint is there"),
        Err(error) => return names_file(error, &["checkpoint.safetensors"]),
    };
    assert_eq!(header.step, optimizer.steps);
    for (slot, expected) in optimizer.slots.iter().zip(fresh().slots) {
        assert_eq!(slot.parameter.shape, expected.parameter.shape);
        for values in [&slot.parameter.values, &slot.first, &slot.second, &slot.average] {
            assert!(values.len() == expected.first.len() && values.iter().all(|v| v.is_finite()));
        }
        assert!(slot.second.iter().all(|v| *v >= 0.0), "a second moment below zero makes every step NaN");
    }
    // Written and read again the run goes on from the same place.
    let copy = FOLDER.join("copy.safetensors");
    checkpoint::save(&copy, &header, &optimizer).expect("a checkpoint can be written");
    let mut again = fresh();
    let read =
        checkpoint::load::<Config>(&copy, &|_| None, None, &mut again).expect("a checkpoint can be read").expect("it is there");
    assert!(again == optimizer && read == header);
    same_again::<CheckpointHeader<Config>>(&header);
    // And goes on at all.
    let gradients = optimizer.slots.iter().map(|slot| Some(vec![0.0; slot.first.len()])).collect::<Vec<_>>();
    optimizer.step(&gradients, 0.0, &RunConfig::default()).expect("a gradient of zeros is finite");
}

/// The text before the first NUL as the list of tensors of a safetensors file, the rest as their bytes.
fn whole(bytes: &[u8]) -> Option<Vec<u8>> {
    let end = bytes.iter().position(|&byte| byte == 0)?;
    let length = (end as u64).to_le_bytes();
    Some([&length, &bytes[..end], &bytes[end + 1..]].concat())
}
