//! The Intelligent Driver Model: acceleration from speed, gap and approach rate.
//!
//! Source: Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and
//! microscopic simulations", Phys. Rev. E 62 (2000) 1805, eqs. (3)-(4). Mean parameters are the
//! "city" and "highway" values of Treiber and Kesting, Traffic Flow Dynamics (2013), table 11.2.
//! Owns no state and no integration.

/// One driver's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdmParameters {
    /// Desired speed v0, m/s.
    pub desired_speed_m_s: f64,
    /// Time headway T, s.
    pub headway_s: f64,
    /// Jam distance s0, m.
    pub jam_gap_m: f64,
    /// Maximum acceleration a, m/s^2.
    pub acceleration_m_s2: f64,
    /// Comfortable deceleration b, m/s^2.
    pub deceleration_m_s2: f64,
}

/// The free-acceleration exponent delta.
const EXPONENT: i32 = 4;

/// No driver brakes harder than this, m/s^2: about the limit of dry tyres.
pub const HARDEST_BRAKING_M_S2: f64 = 9.0;

impl IdmParameters {
    /// Acceleration in m/s^2 at `speed` (m/s), with `gap` m of free road to a leader that is
    /// approached at `closing` m/s; `None` for no leader.
    pub fn acceleration(&self, speed: f64, leader: Option<(f64, f64)>) -> f64 {
        let free = 1.0 - (speed / self.desired_speed_m_s).powi(EXPONENT);
        let interaction = leader.map_or(0.0, |(gap, closing)| {
            let braking =
                speed * closing / (2.0 * (self.acceleration_m_s2 * self.deceleration_m_s2).sqrt());
            let wanted = self.jam_gap_m + (speed * self.headway_s + braking).max(0.0);
            (wanted / gap.max(0.01)).powi(2)
        });
        (self.acceleration_m_s2 * (free - interaction)).max(-HARDEST_BRAKING_M_S2)
    }

    /// The gap in m at which the driver keeps a speed (m/s) behind an equally fast leader.
    pub fn equilibrium_gap_m(&self, speed: f64) -> f64 {
        let room = 1.0 - (speed / self.desired_speed_m_s).powi(EXPONENT);
        (self.jam_gap_m + speed * self.headway_s) / room.max(1e-3).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::IdmParameters;

    #[test]
    fn the_equilibrium_gap_needs_no_acceleration() {
        let driver = IdmParameters {
            desired_speed_m_s: 15.0,
            headway_s: 1.0,
            jam_gap_m: 2.0,
            acceleration_m_s2: 1.0,
            deceleration_m_s2: 1.5,
        };
        for speed in [0.0, 3.0, 8.0, 14.0] {
            let gap = driver.equilibrium_gap_m(speed);
            assert!(driver.acceleration(speed, Some((gap, 0.0))).abs() < 1e-9);
        }
        assert_eq!(driver.acceleration(15.0, None), 0.0);
        assert_eq!(driver.acceleration(0.0, None), 1.0);
    }
}
