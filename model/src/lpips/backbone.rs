//! The convolutional layers of AlexNet and SqueezeNet 1.1 up to the last tap.
use super::Backbone;
use super::weights::Weights;
use crate::error::Result;
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor, TensorData, activation, module};

/// One convolution: its index in torchvision's `features`, channels, kernel, stride and padding.
struct Shape {
    index: usize,
    channels: [usize; 2],
    kernel: usize,
    stride: usize,
    padding: usize,
}

/// A step of the network. The outputs of tapped steps are the features that are compared.
enum Step {
    /// Convolution and ReLU, tapped.
    Conv(Shape),
    /// Maximum of 3 x 3 pixels with stride 2. The output size is rounded up if `ceil`.
    Pool { ceil: bool },
    /// Fire module (Iandola et al. 2016): 1 x 1 to `squeeze` channels, then 1 x 1 and 3 x 3 to `expand` channels each,
    /// concatenated.
    Fire { index: usize, input: usize, squeeze: usize, expand: usize, tap: bool },
}

fn steps(backbone: Backbone) -> Vec<Step> {
    let conv = |index, input, output, kernel, stride, padding| {
        Step::Conv(Shape { index, channels: [input, output], kernel, stride, padding })
    };
    let fire = |index, input, squeeze, expand, tap| Step::Fire { index, input, squeeze, expand, tap };
    match backbone {
        Backbone::Alex => vec![
            conv(0, 3, 64, 11, 4, 2),
            Step::Pool { ceil: false },
            conv(3, 64, 192, 5, 1, 2),
            Step::Pool { ceil: false },
            conv(6, 192, 384, 3, 1, 1),
            conv(8, 384, 256, 3, 1, 1),
            conv(10, 256, 256, 3, 1, 1),
        ],
        Backbone::Squeeze => vec![
            conv(0, 3, 64, 3, 2, 0),
            Step::Pool { ceil: true },
            fire(3, 64, 16, 64, false),
            fire(4, 128, 16, 64, true),
            Step::Pool { ceil: true },
            fire(6, 128, 32, 128, false),
            fire(7, 256, 32, 128, true),
            Step::Pool { ceil: true },
            fire(9, 256, 48, 192, true),
            fire(10, 384, 48, 192, true),
            fire(11, 384, 64, 256, true),
            fire(12, 512, 64, 256, true),
        ],
    }
}

/// Convolution followed by ReLU.
#[derive(Debug)]
struct Conv {
    weight: Tensor<4>,
    bias: Tensor<1>,
    options: ConvOptions<2>,
}

impl Conv {
    fn read(weights: &Weights, name: &str, shape: &Shape, device: &Device) -> Result<Self> {
        let Shape { channels: [input, output], kernel, stride, padding, .. } = *shape;
        let dims = [output, input, kernel, kernel];
        let weight = weights.values(&format!("net.features.{name}.weight"), &dims)?;
        let bias = weights.values(&format!("net.features.{name}.bias"), &[output])?;
        Ok(Self {
            weight: Tensor::from_data(TensorData::new(weight, dims), device),
            bias: Tensor::from_data(TensorData::new(bias, [output]), device),
            options: ConvOptions::new([stride, stride], [padding, padding], [1, 1], 1),
        })
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        activation::relu(module::conv2d(x, self.weight.clone(), Some(self.bias.clone()), self.options.clone()))
    }
}

#[derive(Debug)]
enum Layer {
    Conv(Box<Conv>),
    Pool(MaxPoolOptions<2>),
    Fire { parts: Box<Fire>, tap: bool },
}

#[derive(Debug)]
struct Fire {
    squeeze: Conv,
    expand1: Conv,
    expand3: Conv,
}

/// A backbone with its weights, for inference.
#[derive(Debug)]
pub struct Network {
    layers: Vec<Layer>,
    tap_channels: Vec<usize>,
}

impl Network {
    pub fn read(backbone: Backbone, weights: &Weights, device: &Device) -> Result<Self> {
        let (mut layers, mut tap_channels) = (vec![], vec![]);
        for step in steps(backbone) {
            layers.push(match step {
                Step::Conv(shape) => {
                    tap_channels.push(shape.channels[1]);
                    Layer::Conv(Box::new(Conv::read(weights, &shape.index.to_string(), &shape, device)?))
                }
                Step::Pool { ceil } => {
                    let mut options = MaxPoolOptions::new([3, 3]).with_stride([2, 2]);
                    options.ceil_mode = ceil;
                    Layer::Pool(options)
                }
                Step::Fire { index, input, squeeze, expand, tap } => {
                    if tap {
                        tap_channels.push(2 * expand);
                    }
                    let conv = |part: &str, input, output, kernel| {
                        let shape = Shape { index, channels: [input, output], kernel, stride: 1, padding: kernel / 2 };
                        Conv::read(weights, &format!("{index}.{part}"), &shape, device)
                    };
                    let parts = Fire {
                        squeeze: conv("squeeze", input, squeeze, 1)?,
                        expand1: conv("expand1x1", squeeze, expand, 1)?,
                        expand3: conv("expand3x3", squeeze, expand, 3)?,
                    };
                    Layer::Fire { parts: Box::new(parts), tap }
                }
            });
        }
        Ok(Self { layers, tap_channels })
    }

    /// Channels of each tap, in order.
    pub fn tap_channels(&self) -> &[usize] {
        &self.tap_channels
    }

    /// The compared features of `x` `[b, 3, h, w]`, each `[b, c, h', w']`.
    pub fn taps(&self, mut x: Tensor<4>) -> Vec<Tensor<4>> {
        let mut taps = Vec::with_capacity(self.tap_channels.len());
        for layer in &self.layers {
            let tapped = match layer {
                Layer::Conv(conv) => {
                    x = conv.forward(x);
                    true
                }
                Layer::Pool(options) => {
                    x = module::max_pool2d(x, options.clone());
                    false
                }
                Layer::Fire { parts, tap } => {
                    let s = parts.squeeze.forward(x);
                    x = Tensor::cat(vec![parts.expand1.forward(s.clone()), parts.expand3.forward(s)], 1);
                    *tap
                }
            };
            if tapped {
                taps.push(x.clone());
            }
        }
        taps
    }
}
