//! The fundamental diagrams: space-mean speed v over density k, and what follows from it.
//!
//! Greenshields (1935): v = v_f (1 - k / k_j). Newell (1961), as in Hu et al., eq.
//! newell_model: v = v_f (1 - exp(-lambda / v_f (1/k - 1/k_j))). Flow is q = k v, capacity
//! its largest value. Parameters stand in the order free-flow speed v_f (km/h), jam density
//! k_j (veh/km/lane), lambda (1/h, the slope of speed over spacing; Newell only).

/// Values of the parameters, or of a gradient; the third is 0 for Greenshields.
pub type Parameters = [f64; 3];

/// A relation between density and speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Model {
    /// v = v_f (1 - k / k_j)
    Greenshields,
    /// v = v_f (1 - exp(-lambda / v_f (1/k - 1/k_j)))
    Newell,
}

/// Steps of the search for capacity; each narrows the interval to 0.618 of its length.
const GOLDEN_STEPS: usize = 100;

impl Model {
    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Greenshields => "greenshields",
            Self::Newell => "newell",
        }
    }

    /// How many parameters it has.
    pub fn count(self) -> usize {
        match self {
            Self::Greenshields => 2,
            Self::Newell => 3,
        }
    }

    /// Speed, km/h, at density `k`, veh/km/lane.
    pub fn speed(self, [v_f, k_j, lambda]: Parameters, k: f64) -> f64 {
        match self {
            Self::Greenshields => v_f * (1.0 - k / k_j),
            Self::Newell if k <= 0.0 => v_f,
            Self::Newell => -v_f * (-lambda / v_f * (1.0 / k - 1.0 / k_j)).exp_m1(),
        }
    }

    /// Derivatives of the speed by the parameters.
    pub fn gradient(self, [v_f, k_j, lambda]: Parameters, k: f64) -> Parameters {
        match self {
            Self::Greenshields => [1.0 - k / k_j, v_f * k / (k_j * k_j), 0.0],
            Self::Newell if k <= 0.0 => [1.0, 0.0, 0.0],
            Self::Newell => {
                let gap = 1.0 / k - 1.0 / k_j;
                let x = lambda / v_f * gap;
                let e = (-x).exp();
                [-(-x).exp_m1() - x * e, lambda * e / (k_j * k_j), gap * e]
            }
        }
    }

    /// The density at which flow is largest, and that flow: capacity, veh/h/lane.
    pub fn capacity(self, parameters: Parameters) -> (f64, f64) {
        let [v_f, k_j, _] = parameters;
        match self {
            Self::Greenshields => (k_j / 2.0, v_f * k_j / 4.0),
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
    pub fn capacity_gradient(self, parameters: Parameters) -> Parameters {
        let (k, _) = self.capacity(parameters);
        self.gradient(parameters, k).map(|slope| slope * k)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_is_that_of_the_papers_fit() {
        // Section "Calibration of the fundamental diagrams", case study I.
        let (k, q) = Model::Newell.capacity([45.03, 239.86, 1396.43]);
        // The paper prints its parameters to 0.01, which moves capacity by some 0.01.
        assert!((q - 873.79).abs() < 0.02, "{q}");
        assert!(k > 20.0 && k < 60.0, "{k}");
    }

    #[test]
    fn gradients_are_those_of_finite_differences() {
        for (model, parameters) in [
            (Model::Greenshields, [80.0, 120.0, 0.0]),
            (Model::Newell, [45.03, 239.86, 1396.43]),
            (Model::Newell, [100.0, 140.0, 2000.0]),
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
    fn an_empty_road_has_free_flow_speed() {
        assert_eq!(Model::Newell.speed([45.0, 200.0, 1400.0], 0.0), 45.0);
        assert_eq!(Model::Newell.gradient([45.0, 200.0, 1400.0], 0.0), [1.0, 0.0, 0.0]);
    }
}
