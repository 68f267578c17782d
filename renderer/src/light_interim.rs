//! Interim uniform-sphere environment sampling.
use glam::Vec3A;
use renderflow_frame::Environment;
/// One direction towards the environment.
pub struct LightSample { /** unit */ pub wi: Vec3A, /** radiance */ pub radiance: Vec3A, /** solid angle */ pub pdf: f32 }
/// Environment light.
pub struct EnvironmentLight { env: Environment }
impl EnvironmentLight {
    /// New.
    pub fn new(env: &Environment) -> Self { Self { env: env.clone() } }
    /// Sample.
    pub fn sample(&self, u: [f32; 2]) -> Option<LightSample> {
        let z = 1.0 - 2.0 * u[0]; let r = (1.0 - z * z).max(0.0).sqrt(); let a = u[1] * std::f32::consts::TAU;
        let wi = Vec3A::new(r * a.cos(), z, r * a.sin());
        Some(LightSample { wi, radiance: self.radiance(wi), pdf: self.pdf(wi) })
    }
    /// Density.
    pub fn pdf(&self, _wi: Vec3A) -> f32 { 0.25 / std::f32::consts::PI }
    /// Radiance.
    pub fn radiance(&self, wi: Vec3A) -> Vec3A { Vec3A::from_array(self.env.radiance(wi)) }
    /// Black.
    pub fn is_black(&self) -> bool { self.env.intensity == 0.0 || self.env.map.pixels.iter().all(|p| *p == [0.0; 3]) }
}
