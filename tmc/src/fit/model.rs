//! The fundamental diagrams: space-mean speed v over density k, and what follows from it.
//!
//! Greenshields (1935): v = v_f (1 - k / k_j). Newell (1961), as in Hu et al., eq.
//! newell_model: v = v_f (1 - exp(-lambda / v_f (1/k - 1/k_j))). Flow is q = k v, capacity
//! its largest value. Daganzo's triangle (1994; Newell 1993): flow v_f k up to capacity, then
//! w (k_j - k), so that v = min(v_f, w (k_j / k - 1)). Van Aerde (1995):
//! k = 1 / (c_1 + c_2 / (v_f - v) + c_3 v), with the constants from v_f, k_j, speed at capacity v_c and
//! capacity q_c as in Rakha (2009, Transportation Letters 1, eq. 2 to 5).
//!
//! Parameters stand in the order free-flow speed v_f (km/h), jam density k_j (veh/km/lane), then
//! lambda (1/h, the slope of speed over spacing) for Newell, the speed w of waves in congestion (km/h)
//! for Daganzo, v_c (km/h) and q_c (veh/h/lane) for Van Aerde.

/// Most parameters of a model.
pub const MOST: usize = 4;
/// Values of the parameters, or of a gradient; those that a model has not are 0.
pub type Parameters = [f64; MOST];

/// A relation between density and speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Model {
    /// v = v_f (1 - k / k_j)
    Greenshields,
    /// v = v_f (1 - exp(-lambda / v_f (1/k - 1/k_j)))
    Newell,
    /// v = min(v_f, w (k_j / k - 1)): a triangle of flow over density
    Daganzo,
    /// k = 1 / (c_1 + c_2 / (v_f - v) + c_3 v)
    VanAerde,
}

/// Steps of the search for capacity; each narrows the interval to 0.618 of its length.
const GOLDEN_STEPS: usize = 100;

impl Model {
    /// All of them, the simplest first.
    pub const ALL: [Self; 4] = [Self::Greenshields, Self::Daganzo, Self::Newell, Self::VanAerde];

    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Greenshields => "greenshields",
            Self::Newell => "newell",
            Self::Daganzo => "daganzo",
            Self::VanAerde => "van-aerde",
        }
    }

    /// How many parameters it has.
    pub fn count(self) -> usize {
        match self {
            Self::Greenshields => 2,
            Self::Newell | Self::Daganzo => 3,
            Self::VanAerde => 4,
        }
    }

    /// Speed, km/h, at density `k`, veh/km/lane.
    pub fn speed(self, [v_f, k_j, third, q_c]: Parameters, k: f64) -> f64 {
        let lambda = third;
        match self {
            Self::Greenshields => v_f * (1.0 - k / k_j),
            Self::Newell if k <= 0.0 => v_f,
            Self::Newell => -v_f * (-lambda / v_f * (1.0 / k - 1.0 / k_j)).exp_m1(),
            Self::Daganzo => v_f.min(third * (k_j / k.max(f64::MIN_POSITIVE) - 1.0)),
            Self::VanAerde => van_aerde_speed([v_f, k_j, third, q_c], k),
        }
    }

    /// Derivatives of the speed by the parameters.
    pub fn gradient(self, parameters: Parameters, k: f64) -> Parameters {
        let [v_f, k_j, lambda, _] = parameters;
        match self {
            Self::Greenshields => [1.0 - k / k_j, v_f * k / (k_j * k_j), 0.0, 0.0],
            Self::Newell if k <= 0.0 => [1.0, 0.0, 0.0, 0.0],
            Self::Newell => {
                let gap = 1.0 / k - 1.0 / k_j;
                let x = lambda / v_f * gap;
                let e = (-x).exp();
                [-(-x).exp_m1() - x * e, lambda * e / (k_j * k_j), gap * e, 0.0]
            }
            Self::Daganzo if k <= capacity_density(v_f, k_j, lambda) => [1.0, 0.0, 0.0, 0.0],
            Self::Daganzo => [0.0, lambda / k, k_j / k - 1.0, 0.0],
            // Its formula says less than the difference of two speeds.
            Self::VanAerde => std::array::from_fn(|index| {
                let step = parameters[index] * 1e-6;
                let shifted = |sign: f64| {
                    let mut shifted = parameters;
                    shifted[index] += sign * step;
                    van_aerde_speed(shifted, k)
                };
                (shifted(1.0) - shifted(-1.0)) / (2.0 * step)
            }),
        }
    }

    /// The density at which flow is largest, and that flow: capacity, veh/h/lane.
    pub fn capacity(self, parameters: Parameters) -> (f64, f64) {
        let [v_f, k_j, third, q_c] = parameters;
        match self {
            Self::Greenshields => (k_j / 2.0, v_f * k_j / 4.0),
            Self::Daganzo => {
                let k = capacity_density(v_f, k_j, third);
                (k, v_f * k)
            }
            Self::VanAerde => (q_c / third, q_c),
            Self::Newell => {
                // Flow is 0 at both ends and concave between them.
                let flow = |k: f64| k * self.speed(parameters, k);
                let ratio = (5f64.sqrt() - 1.0) / 2.0;
                let (mut low, mut high) = (0.0, k_j);
                for _ in 0..GOLDEN_STEPS {
                    let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
                    if flow(a) < flow(b) { low = a } else { high = b }
                }
                let k = f64::midpoint(low, high);
                (k, flow(k))
            }
        }
    }

    /// Derivatives of capacity by the parameters.
    ///
    /// At the largest flow its derivative by density is 0, so that only the direct ones
    /// remain (the envelope theorem): those of the speed there, times the density.
    ///
    /// A triangle has no such derivative at its tip, and Van Aerde's form has capacity as a
    /// parameter: theirs follow from their own formulas.
    pub fn capacity_gradient(self, parameters: Parameters) -> Parameters {
        let [v_f, k_j, w, _] = parameters;
        match self {
            Self::Greenshields | Self::Newell => {
                let (k, _) = self.capacity(parameters);
                self.gradient(parameters, k).map(|slope| slope * k)
            }
            Self::Daganzo => {
                let both = v_f + w;
                [k_j * (w / both).powi(2), v_f * w / both, k_j * (v_f / both).powi(2), 0.0]
            }
            Self::VanAerde => [0.0, 0.0, 0.0, 1.0],
        }
    }

    /// Whether these may be parameters of the model.
    pub fn is_possible(self, [v_f, k_j, third, q_c]: Parameters) -> bool {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        match self {
            // A straight line may rise: whoever fits it says so.
            Self::Greenshields => v_f.is_finite() && k_j.is_finite(),
            Self::Newell | Self::Daganzo => {
                positive(v_f) && positive(k_j) && positive(third) && k_j < LONGEST_JAM
            }
            Self::VanAerde => {
                // Speed at capacity lies in the upper half, and speed falls everywhere.
                let is_ordered = positive(k_j)
                    && k_j < LONGEST_JAM
                    && positive(q_c)
                    && third < 0.999 * v_f
                    && third >= v_f / 2.0
                    && k_j > q_c / third;
                let falls = || {
                    let [_, c2, c3] = van_aerde_constants([v_f, k_j, third, q_c]);
                    c2 / v_f.powi(2) + c3 > 0.0
                };
                is_ordered && falls()
            }
        }
    }
}

/// A descent goes no further, veh/km: the curve no longer changes.
const LONGEST_JAM: f64 = 1e6;

/// Where both sides of a triangle meet, veh/km/lane.
fn capacity_density(v_f: f64, k_j: f64, w: f64) -> f64 {
    w * k_j / (v_f + w)
}

/// c_1, c_2 and c_3 of Van Aerde's form (Rakha 2009, eq. 2 to 5).
fn van_aerde_constants([v_f, k_j, v_c, q_c]: Parameters) -> [f64; 3] {
    let m = (2.0 * v_c - v_f) / (v_f - v_c).powi(2);
    let c2 = 1.0 / (k_j * (m + 1.0 / v_f));
    let c1 = m * c2;
    let c3 = (-c1 + v_c / q_c - c2 / (v_f - v_c)) / v_c;
    [c1, c2, c3]
}

/// The lower root of the form's quadratic in v: below v_f, where spacing falls to 1 / k.
fn van_aerde_speed(parameters: Parameters, k: f64) -> f64 {
    let [v_f, ..] = parameters;
    if k <= 0.0 {
        return v_f;
    }
    let [c1, c2, c3] = van_aerde_constants(parameters);
    let b = c3 * v_f - c1 + 1.0 / k;
    let d = v_f * (1.0 / k - c1) - c2;
    // In this form nothing is lost where c_3 goes to 0.
    2.0 * d / (b + (b * b - 4.0 * c3 * d).max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_is_that_of_the_papers_fit() {
        // Section "Calibration of the fundamental diagrams", case study I.
        let (k, q) = Model::Newell.capacity([45.03, 239.86, 1396.43, 0.0]);
        // The paper prints its parameters to 0.01, which moves capacity by some 0.01.
        assert!((q - 873.79).abs() < 0.02, "{q}");
        assert!(k > 20.0 && k < 60.0, "{k}");
    }

    #[test]
    fn gradients_are_those_of_finite_differences() {
        for (model, parameters) in [
            (Model::Greenshields, [80.0, 120.0, 0.0, 0.0]),
            (Model::Newell, [45.03, 239.86, 1396.43, 0.0]),
            (Model::Newell, [100.0, 140.0, 2000.0, 0.0]),
            (Model::Daganzo, [95.0, 140.0, 18.0, 0.0]),
            (Model::VanAerde, [105.0, 120.0, 85.0, 1900.0]),
        ] {
            for index in 0..model.count() {
                let h = parameters[index] * 1e-5;
                let shifted = |sign: f64| {
                    let mut p = parameters;
                    p[index] += sign * h;
                    p
                };
                let slope = |f: &dyn Fn(Parameters) -> f64| {
                    (f(shifted(1.0)) - f(shifted(-1.0))) / (2.0 * h)
                };
                for k in [1.0, 15.0, 60.0, 119.0] {
                    let expected = slope(&|p| model.speed(p, k));
                    let found = model.gradient(parameters, k)[index];
                    assert!((found - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{found}");
                }
                let expected = slope(&|p| model.capacity(p).1);
                let found = model.capacity_gradient(parameters)[index];
                assert!((found - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{found}");
            }
        }
    }

    #[test]
    fn a_triangle_and_van_aerdes_form_pass_through_their_own_points() {
        let triangle = [100.0, 150.0, 20.0, 0.0];
        assert_eq!(Model::Daganzo.capacity(triangle), (25.0, 2500.0));
        assert_eq!(Model::Daganzo.speed(triangle, 10.0), 100.0);
        assert!((Model::Daganzo.speed(triangle, 50.0) - 40.0).abs() < 1e-12, "20 (150 / 50 - 1)");
        assert_eq!(Model::Daganzo.speed(triangle, 150.0), 0.0);
        let curve = [105.0, 120.0, 85.0, 1900.0];
        let speed = |k: f64| Model::VanAerde.speed(curve, k);
        assert!(Model::VanAerde.is_possible(curve));
        assert!((speed(1900.0 / 85.0) - 85.0).abs() < 1e-9, "capacity at its speed");
        assert!(speed(120.0).abs() < 1e-9 && (speed(1e-9) - 105.0).abs() < 1e-3);
        let flow = |k: f64| k * speed(k);
        for k in [5.0, 15.0, 20.0, 25.0, 40.0, 100.0] {
            assert!(flow(k) < 1900.0, "{k}: {}", flow(k));
        }
    }

    #[test]
    fn an_empty_road_has_free_flow_speed() {
        assert_eq!(Model::Newell.speed([45.0, 200.0, 1400.0, 0.0], 0.0), 45.0);
        assert_eq!(Model::Newell.gradient([45.0, 200.0, 1400.0, 0.0], 0.0), [1.0, 0.0, 0.0, 0.0]);
    }
}
