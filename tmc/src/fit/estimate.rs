//! From points to parameters with intervals: least squares, or robust.
//!
//! Owns the starts, the weights and the covariance. Intervals are 95 % by Student's t. The
//! covariance is s^2 (J'J)^-1, J the derivatives at the solution and s^2 the residual
//! variance with n - p degrees of freedom; capacity follows by the delta method. It supposes
//! independent residuals of one variance; minutes that follow each other are not, so that
//! real intervals are wider.
//!
//! Robust is an M-estimate: Huber's (tuning 1.345) to convergence with the scale from the
//! median absolute residual, then Tukey's bisquare (4.685) at that scale, which gives far
//! outliers no weight. Its covariance is Huber's: s^2 (sum psi^2 / (n - p)) /
//! (mean psi')^2 (J'J)^-1 (Huber 1981, section 7.6).

use super::interval::t_95;
use super::least_squares::{Descent, Matrix, Point, descend, inverse, normal_equations, times};
use super::model::{MOST, Model, Parameters};
use super::starts::starts;

/// Most points on which the starts are compared; the best go on with all points.
const SCREENED: usize = 1000;
/// Starts that go on with all points.
const FINALISTS: usize = 3;
/// Most rounds of reweighting, each way.
const ROUNDS: usize = 100;
const HUBER: f64 = 1.345;
const BISQUARE: f64 = 4.685;
/// The standard deviation of a normal distribution over its median absolute deviation.
const MAD_TO_SD: f64 = 1.4826;
/// A jam density this many times the densest point is extrapolated.
const FAR_BEYOND: f64 = 1.5;
/// No jam is denser, veh/km/lane: a vehicle a metre. A fit that goes beyond has no jam density.
const DENSEST_POSSIBLE: f64 = 1000.0;
/// A half-width of an interval beyond this fraction of the value: the data do not tell.
const UNDETERMINED: f64 = 0.5;

/// A number with its standard error and 95 % interval; without where the data do not tell.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// The number; not a number where the data do not determine it.
    pub value: f64,
    /// One standard error.
    pub se: Option<f64>,
    /// Its 95 % interval.
    pub interval: Option<[f64; 2]>,
}

/// A fitted fundamental diagram.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The fitted model.
    pub model: Model,
    /// Whether robustly.
    pub robust: bool,
    /// Points used.
    pub points: usize,
    /// Those of the model, in its order.
    pub parameters: [Estimate; MOST],
    /// Capacity, veh/h/lane.
    pub capacity: Estimate,
    /// Density at capacity, veh/km/lane.
    pub capacity_density: f64,
    /// Root mean square of the residuals, km/h.
    pub rmse: f64,
    /// Share of the speeds' variance that the fit explains.
    pub r_squared: f64,
    /// Akaike's information criterion with its correction for few points (Hurvich and Tsai 1989);
    /// the least is the best of models that were fitted to the same points.
    pub aicc: f64,
    /// Points whose flow is beyond the upper end of capacity's interval, or beyond capacity where it
    /// has none.
    pub beyond_capacity: usize,
    /// The covariance of the parameters, where the data determine it.
    pub covariance: Option<Matrix>,
    /// Factor from a standard error to half an interval.
    pub t: f64,
    /// Parameters that the data do not determine, in words.
    pub warnings: Vec<String>,
}

impl Fit {
    /// The values of the parameters, for the model.
    pub fn values(&self) -> Parameters {
        let [v_f, k_j, third, fourth] = self.parameters.map(|estimate| estimate.value);
        // Without a jam density the curve is that of the densest jam there is.
        [v_f, if k_j.is_nan() { DENSEST_POSSIBLE } else { k_j }, third, fourth]
    }

    /// Half the width of the 95 % interval of the mean speed at density `k`, km/h.
    pub fn band(&self, k: f64) -> Option<f64> {
        let gradient = self.model.gradient(self.values(), k);
        Some(self.t * quadratic(self.covariance.as_ref()?, gradient).max(0.0).sqrt())
    }
}

fn quadratic(matrix: &Matrix, x: Parameters) -> f64 {
    times(matrix, x).iter().zip(x).map(|(a, b)| a * b).sum()
}

/// Fits `model` to the points.
///
/// # Errors
/// The points are too few, have one density, or no speed that falls.
pub fn fit(model: Model, points: &[Point], robust: bool) -> Result<Fit, String> {
    let count = model.count();
    let (name, needed) = (model.name(), count + 1);
    if points.len() < needed {
        let found = points.len();
        return Err(format!("has {found} points; {name} needs at least {needed}"));
    }
    let mut densities: Vec<f64> = points.iter().map(|&(k, _)| k).collect();
    densities.sort_by(f64::total_cmp);
    densities.dedup();
    if densities.len() < count {
        let [first, ..] = densities[..] else { unreachable!("there are points") };
        let what = if densities.len() == 1 {
            format!("all points have density {first} veh/km")
        } else {
            format!("the points have only {} different densities", densities.len())
        };
        return Err(format!("{what}; {name} needs {count} or more: add other traffic states"));
    }
    let squares = best(model, points)?;
    let (solution, weights) =
        if robust { reweighted(model, points, squares) } else { (squares, Weights::default()) };
    if solution.parameters[1] <= 0.0 || solution.parameters[0] <= 0.0 {
        return Err(format!("speed does not fall with density, so that {name} does not apply"));
    }
    Ok(state(model, points, solution, robust, &weights, &densities))
}

/// The lowest end of descents from several starts.
fn best(model: Model, points: &[Point]) -> Result<Descent, String> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let every = sorted.len().div_ceil(SCREENED);
    let few: Vec<Point> = sorted.iter().copied().step_by(every).collect();
    let mut ends: Vec<Descent> = starts(model, &sorted)?
        .into_iter()
        .map(|start| descend(model, &few, &|_| 1.0, start))
        .filter(|end| end.sum.is_finite())
        .collect();
    ends.sort_by(|a, b| a.sum.total_cmp(&b.sum));
    ends.dedup_by(|a, b| {
        (0..model.count()).all(|i| (a.parameters[i] / b.parameters[i] - 1.0).abs() < 1e-4)
    });
    let finals = ends.into_iter().take(FINALISTS);
    finals
        .map(|end| descend(model, points, &|_| 1.0, end.parameters))
        .min_by(|a, b| a.sum.total_cmp(&b.sum))
        .ok_or_else(|| "no descent comes to an end; are the units km/h and veh/km?".to_owned())
}

/// Weighting of the residuals, for the covariance; by default plain least squares.
#[derive(Default)]
struct Weights {
    /// Scale of the residuals, km/h, and the tuning of the bisquare.
    robust: Option<f64>,
}

fn residuals(model: Model, points: &[Point], parameters: Parameters) -> Vec<f64> {
    points.iter().map(|&(k, v)| v - model.speed(parameters, k)).collect()
}

fn reweighted(model: Model, points: &[Point], start: Descent) -> (Descent, Weights) {
    let mut at = start;
    let mut scale = 0.0;
    for bisquare in [false, true] {
        for _ in 0..ROUNDS {
            let residuals = residuals(model, points, at.parameters);
            if !bisquare {
                scale = spread(&residuals);
            }
            // Points that lie on the curve exactly leave nothing to weigh.
            if scale <= 0.0 {
                return (at, Weights { robust: None });
            }
            let weight = |index: usize| {
                let r = (residuals[index] / scale).abs();
                match bisquare {
                    false if r <= HUBER => 1.0,
                    false => HUBER / r,
                    true if r >= BISQUARE => 0.0,
                    true => (1.0 - (r / BISQUARE).powi(2)).powi(2),
                }
            };
            let next = descend(model, points, &weight, at.parameters);
            let still = (0..model.count()).all(|i| {
                (next.parameters[i] - at.parameters[i]).abs() <= 1e-7 * at.parameters[i].abs()
            });
            at = next;
            if still {
                break;
            }
        }
    }
    (at, Weights { robust: Some(scale) })
}

/// The standard deviation that the median absolute residual stands for.
fn spread(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    *median * MAD_TO_SD
}

/// s^2 of the covariance, (km/h)^2.
fn variance(residuals: &[f64], count: usize, weights: &Weights) -> f64 {
    let n = residuals.len() as f64;
    let free = (residuals.len() - count) as f64;
    let Some(scale) = weights.robust else {
        return residuals.iter().map(|r| r * r).sum::<f64>() / free;
    };
    let (mut squares, mut slopes) = (0.0, 0.0);
    for r in residuals {
        let u = (r / (scale * BISQUARE)).powi(2);
        if u < 1.0 {
            squares += (r * (1.0 - u).powi(2)).powi(2);
            slopes += (1.0 - u) * (1.0 - 5.0 * u);
        }
    }
    squares / free / (slopes / n).powi(2)
}

fn state(
    model: Model,
    points: &[Point],
    solution: Descent,
    robust: bool,
    weights: &Weights,
    densities: &[f64],
) -> Fit {
    let (count, values) = (model.count(), solution.parameters);
    let residuals = residuals(model, points, values);
    let s2 = variance(&residuals, count, weights);
    let (normal, _) = normal_equations(model, points, &|_| 1.0, values);
    let endless = model != Model::Greenshields && values[1] > DENSEST_POSSIBLE;
    let covariance = inverse(normal, count)
        .filter(|_| !endless)
        .map(|inverse| inverse.map(|row| row.map(|entry| entry * s2)))
        .filter(|c| (0..count).all(|i| c[i][i].is_finite() && c[i][i] >= 0.0));
    let t = t_95(points.len() - count);
    let estimate = |value: f64, gradient: Parameters| {
        let se = covariance.as_ref().map(|c| quadratic(c, gradient).max(0.0).sqrt());
        Estimate { value, se, interval: se.map(|se| [value - t * se, value + t * se]) }
    };
    let unit = |i: usize| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 });
    let mut parameters = std::array::from_fn(|i| estimate(values[i], unit(i)));
    let (mut capacity_density, mut capacity) = model.capacity(values);
    if endless {
        parameters[1].value = f64::NAN;
        (capacity_density, capacity) = (f64::NAN, f64::NAN);
    }
    let n = points.len() as f64;
    let mean = points.iter().map(|p| p.1).sum::<f64>() / n;
    let squares: f64 = residuals.iter().map(|r| r * r).sum();
    let total: f64 = points.iter().map(|p| (p.1 - mean).powi(2)).sum();
    let mut fit = Fit {
        model,
        robust,
        points: points.len(),
        parameters,
        capacity: estimate(capacity, model.capacity_gradient(values)),
        capacity_density,
        rmse: (squares / n).sqrt(),
        r_squared: if total > 0.0 { 1.0 - squares / total } else { 0.0 },
        aicc: aicc(n, squares, count as f64 + 1.0),
        beyond_capacity: 0,
        covariance,
        t,
        warnings: Vec::new(),
    };
    let most = fit.capacity.interval.map_or(fit.capacity.value, |[_, high]| high);
    fit.beyond_capacity = points.iter().filter(|&&(k, v)| k * v > most).count();
    fit.warnings = warnings(&fit, densities.last().copied().unwrap_or_default());
    fit
}

/// Akaike's criterion of least squares over `n` points with `free` parameters, the variance with
/// them: n ln(sum / n) + 2 free n / (n - free - 1).
fn aicc(n: f64, squares: f64, free: f64) -> f64 {
    let left = n - free - 1.0;
    if left <= 0.0 {
        return f64::INFINITY;
    }
    n * (squares / n).max(f64::MIN_POSITIVE).ln() + 2.0 * free * n / left
}

/// Warnings of parameters that the data do not determine.
fn warnings(fit: &Fit, densest: f64) -> Vec<String> {
    let mut said = Vec::new();
    let jam = fit.parameters[1].value;
    if jam.is_nan() {
        said.push(
            "the points do not determine jam density and capacity: the fit improves up to any \
             density; add congested traffic, or fit greenshields"
                .to_owned(),
        );
    } else if fit.covariance.is_none() {
        said.push(
            "the points do not determine all parameters, so that there are no intervals: add \
             other traffic states, or fit greenshields"
                .to_owned(),
        );
    }
    if jam > FAR_BEYOND * densest {
        said.push(format!(
            "jam density {jam:.1} veh/km is {:.1} times the densest point ({densest:.1}): \
             extrapolated, not measured",
            jam / densest
        ));
    }
    if fit.capacity_density > densest {
        said.push(format!(
            "capacity lies at {:.1} veh/km, beyond the densest point ({densest:.1}): \
             extrapolated, not measured",
            fit.capacity_density
        ));
    }
    if fit.beyond_capacity > 0 {
        said.push(format!(
            "{} of {} points have a flow beyond capacity's interval: the curve is the mean of speeds, \
             not an upper edge",
            fit.beyond_capacity, fit.points
        ));
    }
    let third = match fit.model {
        Model::Greenshields => None,
        Model::Newell => Some("lambda"),
        Model::Daganzo => Some("wave speed"),
        Model::VanAerde => Some("speed at capacity"),
    };
    let named = [
        ("free-flow speed", Some(&fit.parameters[0])),
        ("jam density", Some(&fit.parameters[1])),
        (third.unwrap_or_default(), third.map(|_| &fit.parameters[2])),
        ("capacity", Some(&fit.capacity)),
    ];
    for (name, estimate) in named {
        let Some((value, se)) = estimate.and_then(|e| Some((e.value, e.se?))) else { continue };
        if fit.t * se > UNDETERMINED * value {
            said.push(format!("{name} is not determined: {value:.1} +- {:.1}", fit.t * se));
        }
    }
    said
}
