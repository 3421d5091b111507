//! Light on the street: sun, sky, lamps; how surfaces reflect it; how it becomes 8-bit levels.
//!
//! Owns radiometry in arbitrary linear units and the camera's exposure. A physically inspired
//! look and not a measurement: levels were set by eye against real traffic cameras.

use nalgebra::Vector3;

use crate::scene::{Daylight, Scene};
use crate::vehicle::mesh::Material;
use crate::vehicle::paint::{Livery, Rgb};

/// A sun lower than this casts shadows as long as at it, sine of its height: 5.7 degrees.
pub const LOWEST_SUN: f64 = 0.1;

/// The light of a scene.
#[derive(Debug, Clone)]
pub struct Lighting {
    /// Direction towards the sun.
    pub to_sun: Vector3<f64>,
    /// Sunlight on a surface that faces it.
    pub sun: Rgb,
    /// Share of it that comes straight from the sun's disc and casts shadows, 0 to 1.
    pub direct: f32,
    /// Light of the sky from above.
    pub sky: Rgb,
    /// Light of a street lamp below it.
    pub lamp: Rgb,
    /// Radiance of the sky at the horizon and overhead.
    pub horizon: Rgb,
    /// Radiance of the sky overhead.
    pub zenith: Rgb,
    /// Factor before the 8-bit curve.
    pub exposure: f32,
    /// Vehicles have their lights on.
    pub lights_on: bool,
    /// Strength of glare around lights, 0 to 1.
    pub glare: f32,
    /// Wetness of the road, 0 to 1.
    pub wet: f32,
    /// Distance at which haze hides 63 %, m.
    pub haze_m: f32,
}

impl Lighting {
    /// The light a scene asks for.
    pub fn of(scene: &Scene) -> Self {
        let light = &scene.light;
        let (azimuth, elevation) =
            (light.sun_azimuth_deg.to_radians(), light.sun_elevation_deg.to_radians());
        let to_sun = Vector3::new(
            azimuth.sin() * elevation.cos(),
            azimuth.cos() * elevation.cos(),
            elevation.sin(),
        );
        let rain = light.rain as f32;
        let cloud = (light.cloud as f32).max(rain.sqrt());
        let clear = (1.0 - cloud).max(0.0);
        let mut lighting = match light.daylight {
            Daylight::Day => Lighting {
                to_sun,
                sun: scale([1.0, 0.95, 0.86], 2.4 * clear * clear + 0.12 * (1.0 - clear)),
                direct: 2.4 * clear * clear / (2.4 * clear * clear + 0.12 * (1.0 - clear)),
                sky: mix([0.50, 0.60, 0.78], [0.98, 1.0, 1.04], cloud),
                lamp: [0.0; 3],
                horizon: mix([0.80, 0.88, 0.98], [0.9, 0.92, 0.94], cloud),
                zenith: mix([0.25, 0.42, 0.80], [0.75, 0.78, 0.82], cloud),
                exposure: 0.62 + 0.22 * cloud,
                lights_on: rain > 0.2,
                glare: 0.25 * rain,
                wet: rain.min(1.0),
                haze_m: 2200.0,
            },
            Daylight::Dusk => Lighting {
                to_sun,
                sun: [0.0; 3],
                direct: 0.0,
                sky: [0.105, 0.110, 0.135],
                lamp: [0.10, 0.07, 0.035],
                horizon: [0.20, 0.15, 0.14],
                zenith: [0.035, 0.05, 0.11],
                exposure: 3.0,
                lights_on: true,
                glare: 0.5,
                wet: rain,
                haze_m: 1500.0,
            },
            Daylight::Night => Lighting {
                to_sun,
                sun: [0.0; 3],
                direct: 0.0,
                sky: [0.016, 0.016, 0.019],
                lamp: [0.34, 0.26, 0.16],
                horizon: [0.012, 0.010, 0.010],
                zenith: [0.003, 0.003, 0.005],
                exposure: 3.4,
                lights_on: true,
                glare: 1.0,
                wet: rain,
                haze_m: 1500.0,
            },
        };
        lighting.haze_m /= 1.0 + 6.0 * rain;
        lighting
    }

    /// Light that falls on a surface with a normal (world axes), with `shade` 1 in the sun.
    pub fn irradiance(&self, normal: &Vector3<f64>, shade: f32, lamp: f32) -> Rgb {
        let up = (0.5 + 0.5 * normal.z) as f32;
        let sun = shade * normal.dot(&self.to_sun).max(0.0) as f32;
        std::array::from_fn(|k| {
            // The road throws back about a fifth of what falls on it.
            let bounce = 0.2 * (self.sun[k] * self.to_sun.z as f32 + self.sky[k]) * (1.0 - up);
            // Lamps stand above and beside: half of their light is direction-free.
            let lamp = self.lamp[k] * lamp * (0.35 + 0.65 * up);
            self.sun[k] * sun + self.sky[k] * up + bounce + lamp
        })
    }

    /// Radiance of the surroundings in a direction, for reflections.
    pub fn surroundings(&self, direction: &Vector3<f64>) -> Rgb {
        let z = direction.z as f32;
        if z >= 0.0 {
            return mix(self.horizon, self.zenith, z.sqrt().min(1.0));
        }
        let ground = scale(self.irradiance(&Vector3::z(), 1.0, 0.5), 0.16 / 2.0);
        mix(self.horizon, ground, (-4.0 * z).min(1.0))
    }

    /// Radiance of a vehicle's face towards the eye. `to_eye` and `normal` are unit, world axes.
    pub fn face(
        &self,
        livery: &Livery,
        material: Material,
        normal: &Vector3<f64>,
        to_eye: &Vector3<f64>,
        braking: bool,
    ) -> Rgb {
        let reflectance = livery.reflectance(material);
        let light = self.irradiance(normal, 1.0, 0.8);
        let mut out = [0.0; 3];
        for k in 0..3 {
            out[k] = reflectance[k] * light[k];
        }
        // Schlick's approximation of Fresnel reflection; the second value is the gloss.
        let (f0, gloss) = match material {
            Material::Glass => (0.08, 1.0),
            Material::Paint | Material::Roof | Material::Helmet => (0.04, 0.7),
            Material::Headlight | Material::Rim => (0.06, 0.6),
            Material::Trim => (0.03, 0.3),
            _ => (0.0, 0.0),
        };
        if gloss > 0.0 {
            let cos = normal.dot(to_eye).clamp(0.0, 1.0);
            let mirror = 2.0 * cos * normal - to_eye;
            let fresnel = gloss * (f0 + (1.0 - f0) * (1.0 - cos as f32).powi(5));
            let environment = self.surroundings(&mirror);
            let highlight = mirror.dot(&self.to_sun).max(0.0).powi(60) as f32;
            for k in 0..3 {
                out[k] += fresnel * environment[k] + gloss * 0.5 * highlight * self.sun[k];
            }
        }
        let own = match material {
            Material::Headlight if self.lights_on => [4.0, 3.9, 3.5],
            Material::Taillight if braking => [1.1, 0.06, 0.04],
            Material::Taillight if self.lights_on => [0.35, 0.015, 0.01],
            Material::Sign if self.lights_on => [0.25, 0.14, 0.01],
            _ => [0.0; 3],
        };
        let strength = if self.glare > 0.4 { 1.0 } else { 0.5 };
        for k in 0..3 {
            out[k] += own[k] * strength;
        }
        out
    }

    /// A radiance at a distance, with haze in front.
    pub fn through_haze(&self, radiance: Rgb, distance_m: f64) -> Rgb {
        let clear = (-(distance_m as f32) / self.haze_m).exp();
        mix(self.horizon, radiance, clear)
    }

    /// The 8-bit levels of a radiance: exposure, a soft shoulder, gamma 2.2, contrast.
    pub fn levels(&self, radiance: Rgb) -> [u8; 3] {
        radiance.map(|value| {
            let x = (value * self.exposure).max(0.0);
            // Linear to 0.7, then a shoulder towards 1.
            let x = if x > 0.7 { 0.7 + 0.3 * (1.0 - (-(x - 0.7) / 0.3).exp()) } else { x };
            let y = x.powf(1.0 / 2.2);
            // Cheap cameras add contrast: a third of the way to a smoothstep.
            let y = y + 0.33 * (y * y * (3.0 - 2.0 * y) - y);
            (255.0 * y).round() as u8
        })
    }
}

/// A colour times a factor.
pub fn scale(colour: Rgb, factor: f32) -> Rgb {
    colour.map(|c| c * factor)
}

/// `a` at t = 0, `b` at t = 1.
pub fn mix(a: Rgb, b: Rgb, t: f32) -> Rgb {
    [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])]
}
