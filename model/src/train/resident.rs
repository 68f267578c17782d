//! The optimiser where a network learns. On the processor it is the one of [`super::optimizer`]. On any other device, values,
//! moments and averages stay in the memory of the device, and the same formulas are composed of burn's operations: with the
//! optimiser on the host, every step would send all weights to the device and read all gradients back.

use super::config::{Method, RunConfig};
use super::optimizer::{self, BETA, EPSILON, MOMENTUM, Optimizer, Pace, Slot};
use crate::device::NetworkDevice;
use crate::parameters::{self, GradientList, Parameter};
use crate::{Error, Result};
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use std::borrow::Cow;

/// Why a step was not taken.
pub(super) enum Refused {
    /// What is not finite; nothing was changed.
    NotFinite(String),
    Failed(Error),
}

impl From<Error> for Refused {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

/// The optimiser of a run.
pub(super) enum Resident {
    Host(Optimizer),
    Device(DeviceOptimizer),
}

impl Resident {
    /// The optimiser beside a network on `device`.
    pub fn new(optimizer: Optimizer, device: &NetworkDevice) -> Self {
        if device.is_cpu() { Self::Host(optimizer) } else { Self::Device(DeviceOptimizer::new(&optimizer, device.device())) }
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        match self {
            Self::Host(optimizer) => optimizer.steps,
            Self::Device(optimizer) => optimizer.steps,
        }
    }

    /// Counts a step that was not taken.
    pub fn pass(&mut self) {
        match self {
            Self::Host(optimizer) => optimizer.steps += 1,
            Self::Device(optimizer) => optimizer.steps += 1,
        }
    }

    /// Takes a step, as [`Optimizer::step`] does.
    ///
    /// # Errors
    /// [`Refused::NotFinite`] for a gradient that is not finite, and [`Refused::Failed`] when the device fails, which may then
    /// have lost the state.
    pub fn step(&mut self, gradients: GradientList, learning_rate: f32, run: &RunConfig) -> std::result::Result<f32, Refused> {
        match self {
            Self::Host(optimizer) => {
                let gradients = parameters::read_gradients(gradients)?;
                let named = |parameter| Refused::NotFinite(format!("the gradient of {parameter}"));
                optimizer.step(&gradients, learning_rate, run).map_err(named)
            }
            Self::Device(optimizer) => optimizer.step(&gradients, learning_rate, run),
        }
    }

    /// `model` with the current values, on `device`, which records operations.
    pub fn put_into<M: Module>(&self, model: M, device: &Device) -> M {
        match self {
            Self::Host(optimizer) => parameters::import_learning(model, &optimizer.values(), device),
            Self::Device(optimizer) => parameters::import_tensors(model, optimizer.slots.iter().map(|slot| slot.value.clone())),
        }
    }

    /// The state in the memory of the host.
    ///
    /// # Errors
    /// When the device fails.
    pub fn on_host(&self) -> Result<Cow<'_, Optimizer>> {
        match self {
            Self::Host(optimizer) => Ok(Cow::Borrowed(optimizer)),
            Self::Device(optimizer) => Ok(Cow::Owned(optimizer.read()?)),
        }
    }

    /// Replaces the state.
    pub fn replace(&mut self, by: Optimizer) {
        match self {
            Self::Host(optimizer) => *optimizer = by,
            Self::Device(optimizer) => *optimizer = DeviceOptimizer::new(&by, &optimizer.device),
        }
    }
}

/// AdamW and Muon on a device.
pub(super) struct DeviceOptimizer {
    slots: Vec<DeviceSlot>,
    steps: u64,
    device: Device,
}

/// A [`Slot`] whose numbers are on a device.
struct DeviceSlot {
    name: String,
    shape: Vec<usize>,
    value: Tensor<1>,
    first: Tensor<1>,
    second: Tensor<1>,
    average: Tensor<1>,
}

impl DeviceOptimizer {
    /// A copy of `optimizer` on `device`, which records nothing.
    pub fn new(optimizer: &Optimizer, device: &Device) -> Self {
        let put = |values: &[f32]| Tensor::<1>::from_data(TensorData::new(values.to_vec(), [values.len()]), device);
        let slot = |slot: &Slot| DeviceSlot {
            name: slot.parameter.name.clone(),
            shape: slot.parameter.shape.clone(),
            value: put(&slot.parameter.values),
            first: put(&slot.first),
            second: put(&slot.second),
            average: put(&slot.average),
        };
        Self { slots: optimizer.slots.iter().map(slot).collect(), steps: optimizer.steps, device: device.clone() }
    }

    fn read(&self) -> Result<Optimizer> {
        let slot = |slot: &DeviceSlot| -> Result<Slot> {
            let values = |tensor: &Tensor<1>| parameters::read(tensor.clone());
            Ok(Slot {
                parameter: Parameter { name: slot.name.clone(), shape: slot.shape.clone(), values: values(&slot.value)? },
                first: values(&slot.first)?,
                second: values(&slot.second)?,
                average: values(&slot.average)?,
            })
        };
        Ok(Optimizer { slots: self.slots.iter().map(slot).collect::<Result<_>>()?, steps: self.steps })
    }

    /// [`Optimizer::step`]. The sums of squares of the gradients are all that the host reads.
    fn step(&mut self, gradients: &GradientList, learning_rate: f32, run: &RunConfig) -> std::result::Result<f32, Refused> {
        let known: Vec<(usize, &Tensor<1>)> =
            gradients.iter().enumerate().filter_map(|(i, gradient)| Some((i, gradient.as_ref()?))).collect();
        let squares: Vec<f32> = match known.is_empty() {
            true => Vec::new(),
            false => {
                let square = |(_, gradient): &(usize, &Tensor<1>)| ((*gradient).clone() * (*gradient).clone()).sum();
                parameters::read(Tensor::cat(known.iter().map(square).collect(), 0))?
            }
        };
        // A sum of squares in single precision overflows long after training has failed.
        if let Some(i) = squares.iter().position(|square| !square.is_finite()) {
            return Err(Refused::NotFinite(format!("the gradient of {}", self.slots[known[i].0].name)));
        }
        let norm = squares.iter().map(|square| f64::from(*square)).sum::<f64>().sqrt() as f32;
        self.steps += 1;
        let pace = Pace::new(self.steps, norm, learning_rate, run);
        for (slot, gradient) in self.slots.iter_mut().zip(gradients) {
            if let Some(gradient) = gradient {
                slot.update(gradient, &pace, run.optimizer);
            }
        }
        Ok(norm)
    }
}

impl DeviceSlot {
    fn update(&mut self, gradient: &Tensor<1>, pace: &Pace, method: Method) {
        let gradient = gradient.clone().mul_scalar(pace.clip);
        let decayed = |value: Tensor<1>| value.mul_scalar(1.0 - pace.learning_rate * pace.weight_decay);
        match optimizer::matrix(&self.shape).filter(|_| method == Method::Muon) {
            Some([rows, columns]) => {
                let mix = |first: Tensor<1>| first.mul_scalar(MOMENTUM) + gradient.clone().mul_scalar(1.0 - MOMENTUM);
                self.first = mix(self.first.clone());
                let momentum = mix(self.first.clone());
                let norm = (momentum.clone() * momentum.clone()).sum().sqrt().clamp_min(f32::MIN_POSITIVE);
                let along = optimizer::orthogonal((momentum / norm).reshape([rows, columns])).reshape([rows * columns]);
                self.value = decayed(self.value.clone()) - along.mul_scalar(pace.muon([rows, columns]));
            }
            None => {
                let mix = |moment: Tensor<1>, new: Tensor<1>, beta: f32| moment.mul_scalar(beta) + new.mul_scalar(1.0 - beta);
                self.first = mix(self.first.clone(), gradient.clone(), BETA[0]);
                self.second = mix(self.second.clone(), gradient.clone() * gradient, BETA[1]);
                let root = self.second.clone().mul_scalar(pace.correction[1]).sqrt().add_scalar(EPSILON);
                let along = self.first.clone().mul_scalar(pace.learning_rate * pace.correction[0]) / root;
                let value = self.value.clone();
                self.value = if self.shape.len() > 1 { decayed(value) } else { value } - along;
            }
        }
        self.average = self.average.clone().mul_scalar(pace.ema) + self.value.clone().mul_scalar(1.0 - pace.ema);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A matrix of convolutions, a plain matrix and a bias, with gradients of changing size; one of them is missing at times.
    #[test]
    fn both_places_take_the_same_steps() {
        let shapes = [vec![3, 3, 4, 6], vec![5, 7], vec![6]];
        let wave = |count: usize, phase: f32| (0..count).map(|i| (i as f32 * 0.37 + phase).sin()).collect::<Vec<f32>>();
        for method in [Method::AdamW, Method::Muon] {
            let run = RunConfig { optimizer: method, clip_norm: 2.0, ..RunConfig::default() };
            let parameter = |(i, shape): (usize, &Vec<usize>)| Parameter {
                name: format!("p{i}"),
                shape: shape.clone(),
                values: wave(shape.iter().product(), i as f32),
            };
            let mut host = Optimizer::new(shapes.iter().enumerate().map(parameter).collect());
            let device = Device::flex();
            let mut resident = Resident::Device(DeviceOptimizer::new(&host, &device));
            for step in 0..20 {
                let size = [0.1, 3.0, 0.0][step % 3];
                let gradients: Vec<Option<Vec<f32>>> = (0..shapes.len())
                    .map(|i| {
                        let values = wave(shapes[i].iter().product(), (step * 3 + i) as f32);
                        (step % 4 != i).then(|| values.into_iter().map(|v| size * v).collect())
                    })
                    .collect();
                let tensors = gradients.iter().map(|g| g.as_ref().map(|g| Tensor::from_data(g.as_slice(), &device))).collect();
                let norms = [host.step(&gradients, 0.01, &run), resident.step(tensors, 0.01, &run).map_err(|_| String::new())];
                let [there, here] = norms.map(|norm| norm.expect("finite gradients"));
                assert!((there - here).abs() <= 1e-5 * there, "{there} {here}");
            }
            let read = resident.on_host().expect("readable");
            assert_eq!((read.steps, resident.steps()), (20, 20));
            for (a, b) in host.slots.iter().zip(&read.slots) {
                assert_eq!((&a.parameter.name, &a.parameter.shape), (&b.parameter.name, &b.parameter.shape));
                let [a, b] = [a, b].map(|s| [&s.parameter.values, &s.first, &s.second, &s.average].map(Vec::clone).concat());
                assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-5), "{method:?}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_gradient_that_is_not_finite_changes_nothing() {
        let parameter = |name: &str| Parameter { name: name.into(), shape: vec![2], values: vec![1.0, 2.0] };
        let host = Optimizer::new(vec![parameter("a"), parameter("b"), parameter("c")]);
        let mut resident = Resident::Device(DeviceOptimizer::new(&host, &Device::flex()));
        let tensor = |values: [f32; 2]| Some(Tensor::from_data(values, &Device::flex()));
        let refused = resident.step(vec![tensor([1.0, 1.0]), None, tensor([1.0, f32::NAN])], 0.1, &RunConfig::default());
        assert!(matches!(refused, Err(Refused::NotFinite(what)) if what == "the gradient of c"));
        assert_eq!(*resident.on_host().expect("readable"), host);
        resident.pass();
        assert_eq!(resident.steps(), 1);
    }
}
