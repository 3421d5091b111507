//! Where a vehicle is on its lane and how fast, by a Kalman filter of constant velocity.
//!
//! Owns the motion model and its noise. The acceleration is continuous white noise (Bar-Shalom, Li
//! and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.2.2),
//! so that what is believed does not depend on how often pictures come.

/// Spectral density of the acceleration, m²/s³: 1.6 m/s² that lasts for a second, as in comfortable
/// braking; an emergency stop takes a few pictures more to be followed.
const ACCELERATION: f32 = 2.5;

/// Standard deviation of a contact point in the picture, px: the box's lower edge, and sway of the
/// camera that was not found.
const CONTACT_PX: f32 = 1.6;
/// Standard deviation of a contact point on the road beside that, m.
const CONTACT_M: f32 = 0.3;
/// Growth of the variance of the place of a vehicle that stands unseen, m²/s, and its most, m²: beyond
/// it would be taken for the next one.
const STANDING_M2_S: f32 = 0.5;
const STANDING_M2: f32 = 4.0;
/// Fastest that a vehicle rolls back, m/s: more is noise.
const BACKWARDS_M_S: f32 = 0.5;

/// Variance of a place, m², where a pixel spans `span_m` of the road.
pub(super) fn place_variance(span_m: f32) -> f32 {
    let by_px = CONTACT_PX * span_m;
    CONTACT_M * CONTACT_M + by_px * by_px
}

/// Place and speed, and what is known of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    /// Along the lane from its upstream end, m.
    pub(super) s_m: f32,
    /// m/s.
    pub(super) v_m_s: f32,
    /// Variances and covariance.
    ss: f32,
    sv: f32,
    vv: f32,
}

impl Motion {
    /// A vehicle that was seen once: `variance` of its place, speed `v` by others, `v_sd` of it.
    pub(super) const fn first(s_m: f32, variance: f32, v_m_s: f32, v_sd: f32) -> Self {
        Self { s_m, v_m_s, ss: variance, sv: 0.0, vv: v_sd * v_sd }
    }

    /// Lets `dt` seconds pass.
    pub(super) fn predict(&mut self, dt: f32) {
        self.s_m += self.v_m_s * dt;
        let q = ACCELERATION;
        self.ss += dt * (2.0 * self.sv + dt * self.vv) + q * dt * dt * dt / 3.0;
        self.sv += dt * self.vv + q * dt * dt / 2.0;
        self.vv += q * dt;
    }

    /// Lets `dt` seconds pass in which the vehicle is taken to stand, within a car's length.
    pub(super) fn stand(&mut self, dt: f32) {
        (self.v_m_s, self.sv) = (0.0, 0.0);
        self.ss = (self.ss + dt * STANDING_M2_S).min(self.ss.max(STANDING_M2));
    }

    /// Takes a place seen with that variance.
    pub(super) fn update(&mut self, seen_m: f32, variance: f32) {
        let innovation = self.innovation_variance(variance);
        let (ks, kv) = (self.ss / innovation, self.sv / innovation);
        let residual = seen_m - self.s_m;
        self.s_m += ks * residual;
        self.v_m_s = (self.v_m_s + kv * residual).max(-BACKWARDS_M_S);
        self.vv -= kv * self.sv;
        self.sv *= 1.0 - ks;
        self.ss *= 1.0 - ks;
    }

    /// Variance of what is seen, about what is expected, m².
    pub(super) fn innovation_variance(&self, variance: f32) -> f32 {
        self.ss + variance
    }

    /// Variance of the place, m².
    pub(super) const fn variance(&self) -> f32 {
        self.ss
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard errors of place and speed after that long of pictures in that interval.
    fn known_after(seconds: f32, dt: f32) -> (f32, f32) {
        let mut motion = Motion::first(0.0, 1.0, 10.0, 10.0);
        for _ in 0..(seconds / dt) as u32 {
            motion.predict(dt);
            motion.update(motion.s_m, 1.0);
        }
        (libm::sqrtf(motion.ss), libm::sqrtf(motion.vv))
    }

    #[test]
    fn more_pictures_tell_more_and_none_of_them_certainty() {
        let (slow, fast) = (known_after(5.0, 0.2), known_after(5.0, 0.04));
        assert!(fast.0 < slow.0 && fast.1 < slow.1, "{slow:?} {fast:?}");
        assert!((0.1..0.8).contains(&fast.0) && (0.5..2.0).contains(&fast.1), "{fast:?}");
    }

    #[test]
    fn steady_speed_is_found_from_a_wrong_one() {
        let mut motion = Motion::first(0.0, 0.1, 5.0, 10.0);
        for step in 1..=20_u8 {
            motion.predict(0.2);
            motion.update(f32::from(step) * 0.2 * 20.0, 0.1);
        }
        assert!((motion.v_m_s - 20.0).abs() < 0.1, "{motion:?}");
        assert!((motion.s_m - 80.0).abs() < 0.1, "{motion:?}");
    }

    #[test]
    fn nobody_drives_backwards() {
        let mut motion = Motion::first(50.0, 0.1, 0.0, 3.0);
        for step in 1..=20_u8 {
            motion.predict(0.2);
            motion.update(50.0 - f32::from(step), 0.1);
        }
        assert!(motion.v_m_s >= -BACKWARDS_M_S, "{motion:?}");
    }
}
