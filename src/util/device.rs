//! The option that chooses the device of the networks.

use anyhow::Result;
use clap::Args;
use renderflow_model::device::{DeviceChoice, NetworkDevice};

/// Help of the option for training, which multiplies as its configuration says.
pub const TRAINING: &str = "Device that networks run on: cpu, vulkan or cuda; auto is the first GPU that is found, or the \
    processor; vulkan:1 is the second GPU. GPUs need a build with the feature vulkan or cuda, and `renderflow doctor` lists them";

/// Help of the option for pictures.
const PICTURES: &str = "Device that networks run on: cpu, vulkan or cuda; auto is the first GPU that is found, or the \
    processor; vulkan:1 is the second GPU. The processor multiplies in bf16 where it can, and with cpu:f32 in 32-bit floats. \
    GPUs need a build with the feature vulkan or cuda, and `renderflow doctor` lists them";

/// Where networks run.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct DeviceArgs {
    #[arg(long, default_value_t, help = PICTURES, help_heading = "Network")]
    device: DeviceChoice,
}

impl From<Option<DeviceChoice>> for DeviceArgs {
    fn from(device: Option<DeviceChoice>) -> Self {
        Self { device: device.unwrap_or_default() }
    }
}

impl DeviceArgs {
    /// Opens the device, and tells the user which one it is unless it is the processor.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn open(self) -> Result<NetworkDevice> {
        let device = self.get()?;
        if !device.is_cpu() {
            eprintln!("note: networks run on {device}");
        }
        Ok(device)
    }

    /// The device that [`Self::open`] opened.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn get(self) -> Result<NetworkDevice> {
        Ok(NetworkDevice::open(self.device)?)
    }
}

/// What a record of results says about the device: results of different devices differ a little. Nothing is said of
/// the processor as it is by default.
pub fn recorded(device: &NetworkDevice) -> Option<String> {
    (!device.is_default()).then(|| device.to_string())
}
