//! A fit as JSON and as a table.

use super::estimate::{Estimate, Fit};
use super::model::Model;
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// A quantity of a fit.
pub(super) struct Quantity {
    /// Its name in JSON.
    pub(super) name: &'static str,
    /// For people.
    pub(super) words: &'static str,
    pub(super) unit: &'static str,
    pub(super) estimate: Estimate,
}

/// The quantities of a fit, in the order of the output.
pub(super) fn quantities(fit: &Fit) -> Vec<Quantity> {
    let quantity = |name, words, unit, estimate| Quantity { name, words, unit, estimate };
    let [free, jam, third, _] = fit.parameters;
    let mut all = vec![
        quantity("free_flow_speed_kmh", "free-flow speed", "km/h", free),
        quantity("jam_density_veh_km", "jam density", "veh/km/lane", jam),
    ];
    all.extend(match fit.model {
        Model::Greenshields => None,
        Model::Newell => Some(quantity("lambda", "lambda", "1/h", third)),
        Model::Daganzo => Some(quantity("wave_speed_kmh", "wave speed", "km/h", third)),
        Model::VanAerde => {
            Some(quantity("speed_at_capacity_kmh", "speed at capacity", "km/h", third))
        }
    });
    all.push(quantity("capacity_veh_h", "capacity", "veh/h/lane", fit.capacity));
    all
}

/// Models that were fitted to the same points, the best first, with what each lacks of it.
pub(super) fn compared(fits: &[Fit], refused: &[(Model, String)]) -> String {
    let best = fits.first().map_or(0.0, |fit| fit.aicc);
    let mut out =
        String::from("model          parameters       AICc   behind   rmse km/h  r squared\n");
    for fit in fits {
        // Writing to a string does not fail.
        let _ = writeln!(
            out,
            "{:<14} {:>10} {:>10.1} {:>8.1} {:>11.2} {:>10.3}",
            fit.model.name(),
            fit.model.count(),
            fit.aicc,
            fit.aicc - best,
            fit.rmse,
            fit.r_squared
        );
    }
    for (model, reason) in refused {
        let _ = writeln!(out, "{:<14} {reason}", model.name());
    }
    out.push('\n');
    out
}

fn method(fit: &Fit) -> &'static str {
    if fit.robust { "robust" } else { "least_squares" }
}

/// One JSON object and a line end. An interval that the data do not give is null. `fits` are the
/// models that were compared, the best first; none where one was asked for.
pub(super) fn json(fit: &Fit, fits: &[Fit]) -> String {
    let mut values = Map::new();
    let (mut intervals, mut errors) = (Map::new(), Map::new());
    values.insert("model".into(), fit.model.name().into());
    values.insert("method".into(), method(fit).into());
    values.insert("points".into(), fit.points.into());
    for Quantity { name, estimate, .. } in quantities(fit) {
        values.insert(name.into(), estimate.value.into());
        let interval = estimate.interval.filter(|ends| ends.iter().all(|end| end.is_finite()));
        intervals.insert(name.into(), interval.map_or(Value::Null, |ends| json!(ends)));
        errors.insert(name.into(), json!(estimate.se));
    }
    values.insert("density_at_capacity_veh_km".into(), fit.capacity_density.into());
    values.insert("confidence".into(), 0.95.into());
    values.insert("intervals".into(), intervals.into());
    values.insert("standard_errors".into(), errors.into());
    values.insert("rmse_kmh".into(), fit.rmse.into());
    values.insert("r_squared".into(), fit.r_squared.into());
    values.insert("aicc".into(), fit.aicc.into());
    values.insert("points_beyond_capacity".into(), fit.beyond_capacity.into());
    if !fits.is_empty() {
        let of = |it: &Fit| json!({"model": it.model.name(), "aicc": it.aicc, "rmse_kmh": it.rmse});
        values.insert("compared".into(), fits.iter().map(of).collect());
    }
    values.insert("warnings".into(), json!(fit.warnings));
    format!("{}\n", Value::Object(values))
}

/// Lines for people.
pub(super) fn table(fit: &Fit) -> String {
    let mut out = format!("{} by {}, {} points\n", fit.model.name(), method(fit), fit.points);
    for Quantity { name, unit, estimate: Estimate { value, interval, .. }, .. } in quantities(fit) {
        let interval = match interval {
            Some([low, high]) => format!("95 % {low:.2} to {high:.2}"),
            None => "no interval: the points do not determine it".to_owned(),
        };
        // Writing to a string does not fail.
        let value = if value.is_nan() { "-".to_owned() } else { format!("{value:.2}") };
        let _ = writeln!(out, "{name:<22} {value:>10} {unit:<12} {interval}");
    }
    if fit.capacity_density.is_finite() {
        let _ = writeln!(out, "density at capacity    {:>10.2} veh/km/lane", fit.capacity_density);
    }
    let _ = writeln!(
        out,
        "rmse {:.2} km/h, r squared {:.3}, AICc {:.1}",
        fit.rmse, fit.r_squared, fit.aicc
    );
    out
}
