//! Devices that networks run on.
//!
//! The processor is always there, and every number in the documentation was computed on it. GPUs need a build with the cargo
//! feature `vulkan` or `cuda`. There, [`crate::kernels::portable`] composes the operations of a network from burn's own, so that
//! results differ from those of `cpu:f32` in their last digits.

use crate::ops::Products;
use crate::{Error, Result};
use burn::tensor::Device;
use serde::Serialize;
use std::fmt;
use std::str::FromStr;
use std::sync::{Mutex, OnceLock, PoisonError};

/// An interface to devices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Interface {
    /// The processor.
    #[default]
    Cpu,
    /// Vulkan, to GPUs of every maker.
    Vulkan,
    /// CUDA, to NVIDIA's GPUs.
    Cuda,
    /// OpenGL, which may be software: for tests on machines without a GPU.
    OpenGl,
}

impl Interface {
    const ALL: [Self; 4] = [Self::Cpu, Self::Vulkan, Self::Cuda, Self::OpenGl];

    fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Vulkan => "vulkan",
            Self::Cuda => "cuda",
            Self::OpenGl => "opengl",
        }
    }

    /// The cargo feature that brings it; `None` for the processor.
    fn feature(self) -> Option<&'static str> {
        match self {
            Self::Cpu => None,
            Self::Vulkan | Self::OpenGl => Some("vulkan"),
            Self::Cuda => Some("cuda"),
        }
    }

    /// Whether this build has it.
    fn is_built(self) -> bool {
        match self {
            Self::Cpu => true,
            Self::Vulkan | Self::OpenGl => cfg!(feature = "vulkan"),
            Self::Cuda => cfg!(feature = "cuda"),
        }
    }
}

/// A choice of device. As text: `cpu`, `cpu:f32`, `vulkan`, `cuda`, `auto`, or the second GPU as `vulkan:1` or `cuda:1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The first GPU of this build's interfaces, CUDA before Vulkan; the processor where there is none.
    Auto,
    /// The device with this number, in the order of [`found`]. Without a number, it is the first one.
    This(Interface, Option<usize>),
    /// The processor, with [`Products::F32`] even where it multiplies faster in bf16.
    Exact,
}

/// [`DeviceChoice::Exact`] as text.
const EXACT: &str = "cpu:f32";

impl Default for DeviceChoice {
    fn default() -> Self {
        Self::This(Interface::Cpu, None)
    }
}

impl DeviceChoice {
    /// The choice of process number `place`, counted from 0, among those that train together on this machine: they take one GPU
    /// after the other, unless the choice has a number.
    #[must_use]
    pub fn of_process(self, place: usize) -> Self {
        match self {
            Self::Auto | Self::This(_, None) if self != Self::default() => self.among(&found(), place),
            _ => self,
        }
    }

    /// [`Self::of_process`] where these devices are found.
    fn among(self, found: &[FoundDevice], place: usize) -> Self {
        let interface = match (self, first(found)) {
            (Self::This(interface, None), _) | (Self::Auto, Some(Self::This(interface, _))) => interface,
            _ => return self,
        };
        let choices = found.iter().filter(|device| device.problem.is_none()).filter_map(|device| device.choice.parse().ok());
        let same: Vec<Self> = choices.filter(|choice| matches!(choice, Self::This(of, _) if *of == interface)).collect();
        if same.is_empty() { self } else { same[place % same.len()] }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::This(interface, None) => f.write_str(interface.name()),
            Self::This(interface, Some(index)) => write!(f, "{}:{index}", interface.name()),
            Self::Exact => f.write_str(EXACT),
        }
    }
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "auto" => return Ok(Self::Auto),
            EXACT => return Ok(Self::Exact),
            _ => {}
        }
        let (name, index) = text.split_once(':').map_or((text, None), |(name, index)| (name, Some(index)));
        let known = Interface::ALL.into_iter().find(|interface| interface.name() == name);
        let interface = known.ok_or("expected cpu, cpu:f32, vulkan, cuda or auto, or the number of a GPU as in vulkan:1")?;
        let Some(index) = index else { return Ok(Self::This(interface, None)) };
        if interface == Interface::Cpu {
            let reason = "the processor has no number, only cpu:f32; RAYON_NUM_THREADS sets how many cores are used";
            return Err(reason.into());
        }
        let index = index.parse().map_err(|_| format!("{index:?} is not the number of a GPU, as in {name}:1"))?;
        Ok(Self::This(interface, Some(index)))
    }
}

/// A device on this machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FoundDevice {
    /// Its text as a [`DeviceChoice`].
    pub choice: String,
    /// Its name, as the driver tells it.
    pub name: String,
    /// The driver with its version; empty where it is not told.
    pub driver: String,
    /// Why networks do not run on it; `None` where they do.
    pub problem: Option<String>,
}

/// A device that is ready to run networks.
#[derive(Clone, Debug)]
pub struct NetworkDevice {
    choice: DeviceChoice,
    name: String,
    device: Device,
    largest: u64,
}

impl Default for NetworkDevice {
    fn default() -> Self {
        Self::cpu()
    }
}

impl NetworkDevice {
    /// The processor.
    pub fn cpu() -> Self {
        Self { choice: DeviceChoice::default(), name: "the processor".into(), device: Device::flex(), largest: u64::MAX }
    }

    /// Opens a device. A device that is open already is returned as it is.
    ///
    /// # Errors
    /// [`Error::Device`] when this build has no such interface, when no GPU with this number is there, when it is software, or
    /// when its driver refuses.
    pub fn open(choice: DeviceChoice) -> Result<Self> {
        static OPEN: Mutex<Vec<NetworkDevice>> = Mutex::new(Vec::new());
        static FIRST: OnceLock<DeviceChoice> = OnceLock::new();
        let choice = match choice {
            DeviceChoice::Auto => *FIRST.get_or_init(|| first(&found()).unwrap_or_default()),
            this => this,
        };
        let (interface, index) = match choice {
            DeviceChoice::Exact => return Ok(Self { choice, ..Self::cpu() }),
            DeviceChoice::Auto | DeviceChoice::This(Interface::Cpu, _) => return Ok(Self::cpu()),
            DeviceChoice::This(interface, index) => (interface, index),
        };
        let index = index.unwrap_or(0);
        let failed = |reason: String| Error::Device { device: choice.to_string(), reason };
        if let (false, Some(feature)) = (interface.is_built(), interface.feature()) {
            let build = format!("cargo build --release --features {feature}");
            return Err(failed(format!("this build runs networks on the processor only; `{build}` makes one for GPUs")));
        }
        let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        let opened = DeviceChoice::This(interface, Some(index));
        if let Some(device) = open.iter().find(|device| device.choice == opened) {
            return Ok(device.clone());
        }
        let device = Self::start(interface, index).map_err(failed)?;
        open.push(device.clone());
        Ok(device)
    }

    #[cfg_attr(not(any(feature = "vulkan", feature = "cuda")), expect(unused_variables, reason = "only GPUs have numbers"))]
    fn start(interface: Interface, index: usize) -> std::result::Result<Self, String> {
        match interface {
            #[cfg(feature = "vulkan")]
            Interface::Vulkan | Interface::OpenGl => wgpu::start(interface, index),
            #[cfg(feature = "cuda")]
            Interface::Cuda => cuda::start(index),
            _ => Err("not part of this build".into()),
        }
    }

    /// The device for tensors.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Its name for a user.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether it is the processor.
    pub fn is_cpu(&self) -> bool {
        matches!(self.choice, DeviceChoice::This(Interface::Cpu, _) | DeviceChoice::Exact)
    }

    /// Whether it is the processor as it is by default.
    pub fn is_default(&self) -> bool {
        self.choice == DeviceChoice::default()
    }

    /// How convolutions multiply for a picture: in bf16 on the processor unless the choice was [`DeviceChoice::Exact`], and in
    /// 32-bit floats on GPUs, which would round the sums as well.
    pub fn products(&self) -> Products {
        if self.is_default() { Products::Bf16 } else { Products::F32 }
    }

    /// Bytes of the largest tensor that it takes.
    pub fn largest_tensor(&self) -> u64 {
        self.largest
    }
}

impl fmt::Display for NetworkDevice {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} ({})", self.choice, self.name)
    }
}

/// The first device on which networks run, other than OpenGL.
fn first(found: &[FoundDevice]) -> Option<DeviceChoice> {
    let works = found.iter().filter(|device| device.problem.is_none());
    let choices = works.filter_map(|device| device.choice.parse().ok());
    let mut choices = choices.filter(|choice| !matches!(choice, DeviceChoice::This(Interface::OpenGl, _)));
    choices.next()
}

/// Every GPU that this build can reach, CUDA's first. Looking starts drivers, which takes up to a second. The processor is not
/// listed.
pub fn found() -> Vec<FoundDevice> {
    #[allow(unused_mut, reason = "a build without GPUs finds none")]
    let mut found = Vec::new();
    #[cfg(feature = "cuda")]
    found.extend(cuda::found());
    #[cfg(feature = "vulkan")]
    for interface in [Interface::Vulkan, Interface::OpenGl] {
        found.extend(wgpu::found(interface));
    }
    found
}

/// GPUs through Vulkan and OpenGL.
#[cfg(feature = "vulkan")]
mod wgpu {
    use super::{DeviceChoice, FoundDevice, Interface, NetworkDevice};
    use burn::tensor::wgpu::WgpuBackend;
    use burn::tensor::wgpu::wgpu::{AdapterInfo, Backends, DeviceType, Instance, InstanceDescriptor};
    use burn::tensor::{Device, DeviceKind};
    use std::pin::pin;
    use std::task::{Context, Poll, Waker};

    /// Software behind Vulkan ends the whole process: Mesa's lavapipe 25 does not take the shaders.
    const SOFTWARE: &str = "it is software, not a GPU, and its Vulkan driver cannot run networks";

    /// Adapters, in the order in which they are numbered.
    fn adapters(interface: Interface) -> Vec<AdapterInfo> {
        let backends = if interface == Interface::OpenGl { Backends::GL } else { Backends::VULKAN };
        let instance = Instance::new(InstanceDescriptor { backends, ..InstanceDescriptor::new_without_display_handle() });
        let listing = pin!(instance.enumerate_adapters(backends));
        // Outside of browsers, the list is there at once.
        match listing.poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(adapters) => adapters.iter().map(|adapter| adapter.get_info()).collect(),
            Poll::Pending => Vec::new(),
        }
    }

    fn driver(info: &AdapterInfo) -> String {
        format!("{} {}", info.driver, info.driver_info).trim().to_owned()
    }

    /// Whether the process would end in the driver.
    fn problem(interface: Interface, info: &AdapterInfo) -> Option<String> {
        (interface == Interface::Vulkan && info.device_type == DeviceType::Cpu).then(|| SOFTWARE.to_owned())
    }

    pub(super) fn found(interface: Interface) -> Vec<FoundDevice> {
        let found = |(index, info): (usize, AdapterInfo)| FoundDevice {
            choice: DeviceChoice::This(interface, Some(index)).to_string(),
            driver: driver(&info),
            problem: problem(interface, &info),
            name: info.name,
        };
        adapters(interface).into_iter().enumerate().map(found).collect()
    }

    pub(super) fn start(interface: Interface, index: usize) -> Result<NetworkDevice, String> {
        let adapters = adapters(interface);
        let info = adapters.get(index).ok_or_else(|| match adapters.len() {
            0 => "no GPU with a driver is found; `renderflow doctor` lists what is".to_owned(),
            count => format!("there are {count} devices, numbered from 0; `renderflow doctor` lists them"),
        })?;
        if let Some(problem) = problem(interface, info) {
            return Err(format!("{}: {problem}", info.name));
        }
        // burn counts the adapters of each type apart.
        let before = adapters[..index].iter().filter(|other| other.device_type == info.device_type).count();
        let kind = match info.device_type {
            DeviceType::DiscreteGpu => DeviceKind::DiscreteGpu(before),
            DeviceType::IntegratedGpu => DeviceKind::IntegratedGpu(before),
            DeviceType::VirtualGpu => DeviceKind::VirtualGpu(before),
            DeviceType::Cpu => DeviceKind::Cpu,
            DeviceType::Other => DeviceKind::DefaultDevice,
        };
        let api = if interface == Interface::OpenGl { WgpuBackend::Gl } else { WgpuBackend::Vulkan };
        let options = Device::wgpu_options().device_kind(kind).graphics_api(api);
        let (device, setup) = options.init_with_setup().map_err(|error| error.to_string())?;
        // What was opened is asked again: burn's choice is its own.
        let opened = setup.adapter.get_info();
        if let Some(problem) = problem(interface, &opened) {
            return Err(format!("{}: {problem}", opened.name));
        }
        let limits = setup.device.limits();
        let largest = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        Ok(NetworkDevice { choice: DeviceChoice::This(interface, Some(index)), name: opened.name, device, largest })
    }
}

/// NVIDIA's GPUs.
#[cfg(feature = "cuda")]
mod cuda {
    use super::{DeviceChoice, FoundDevice, Interface, NetworkDevice};
    use burn::tensor::{Device, DeviceType, Tensor};
    use std::panic::catch_unwind;

    /// A sum on the device: where the driver is missing, the first operation panics.
    fn works(index: usize) -> Result<Device, String> {
        let tried = catch_unwind(|| {
            let device = Device::cuda(index);
            Tensor::<1>::from_data([1.0_f32, 2.0], &device).sum().try_into_vec_as::<f32>().map(|_| device)
        });
        match tried {
            Ok(device) => device.map_err(|error| error.to_string()),
            Err(_) => Err("CUDA's driver does not start".into()),
        }
    }

    pub(super) fn found() -> Vec<FoundDevice> {
        let count = catch_unwind(|| Device::enumerate(DeviceType::Cuda).len()).unwrap_or(0);
        let found = |index: usize| FoundDevice {
            choice: DeviceChoice::This(Interface::Cuda, Some(index)).to_string(),
            name: format!("CUDA device {index}"),
            driver: String::new(),
            problem: works(index).err(),
        };
        (0..count).map(found).collect()
    }

    pub(super) fn start(index: usize) -> Result<NetworkDevice, String> {
        let device = works(index)?;
        let choice = DeviceChoice::This(Interface::Cuda, Some(index));
        Ok(NetworkDevice { choice, name: format!("CUDA device {index}"), device, largest: u64::MAX })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_read_as_they_are_written() {
        for text in ["cpu", "cpu:f32", "vulkan", "vulkan:0", "vulkan:1", "cuda", "cuda:7", "auto", "opengl"] {
            assert_eq!(text.parse::<DeviceChoice>().expect(text).to_string(), text);
        }
        assert_eq!("cuda:0".parse(), Ok(DeviceChoice::This(Interface::Cuda, Some(0))));
        for text in
            ["", "gpu", "CPU", "cpu:1", "cpu:bf16", "vulkan:f32", "vulkan:", "vulkan:-1", "vulkan:x", "cuda:1:2", ":1", "auto:1"]
        {
            assert!(text.parse::<DeviceChoice>().is_err(), "{text}");
        }
    }

    #[test]
    fn the_first_device_that_works_is_chosen() {
        let device = |choice: &str, problem: Option<&str>| FoundDevice {
            choice: choice.into(),
            name: String::new(),
            driver: String::new(),
            problem: problem.map(str::to_owned),
        };
        let found = [device("cuda:0", Some("no driver")), device("vulkan:0", Some("software")), device("vulkan:1", None)];
        assert_eq!(first(&found), Some(DeviceChoice::This(Interface::Vulkan, Some(1))));
        assert_eq!(first(&[device("opengl:0", None)]), None);
        assert_eq!(first(&[]), None);
    }

    #[test]
    fn processes_of_one_machine_take_one_gpu_after_the_other() {
        let device = |choice: &str, works: bool| FoundDevice {
            choice: choice.into(),
            name: String::new(),
            driver: String::new(),
            problem: (!works).then(|| "none".to_owned()),
        };
        let found = [device("cuda:0", false), device("vulkan:0", true), device("vulkan:1", false), device("vulkan:2", true)];
        let of = |choice: &str, place: usize| choice.parse::<DeviceChoice>().expect(choice).among(&found, place).to_string();
        for choice in ["auto", "vulkan"] {
            assert_eq!([0, 1, 2, 3].map(|place| of(choice, place)), ["vulkan:0", "vulkan:2", "vulkan:0", "vulkan:2"]);
        }
        assert_eq!(of("vulkan:1", 1), "vulkan:1");
        // Opening it says what is wrong.
        assert_eq!(of("cuda", 1), "cuda");
        assert_eq!(DeviceChoice::Auto.among(&[], 1), DeviceChoice::Auto);
        assert_eq!(DeviceChoice::default().of_process(1), DeviceChoice::default());
    }

    #[cfg(not(any(feature = "vulkan", feature = "cuda")))]
    #[test]
    fn a_build_without_gpus_says_how_to_make_one_with() {
        for (choice, feature) in [("vulkan", "vulkan"), ("cuda:1", "cuda")] {
            let error = NetworkDevice::open(choice.parse().expect("a choice")).expect_err(choice).to_string();
            assert!(
                error.starts_with(&format!("device {choice}: ")) && error.contains(&format!("--features {feature}")),
                "{error}"
            );
        }
        assert!(NetworkDevice::open(DeviceChoice::Auto).expect("the processor").is_cpu());
        assert!(found().is_empty());
    }
}
