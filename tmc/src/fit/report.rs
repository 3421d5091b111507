//! A fit as JSON and as a table.

use super::estimate::{Estimate, Fit};
use super::model::Model;
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// The named quantities of a fit, in the order of the output, with their units.
fn quantities(fit: &Fit) -> Vec<(&'static str, &'static str, Estimate)> {
    let [free, jam, lambda] = fit.parameters;
    let mut all = vec![
        ("free_flow_speed_kmh", "km/h", free),
        ("jam_density_veh_km", "veh/km/lane", jam),
        ("capacity_veh_h", "veh/h/lane", fit.capacity),
    ];
    if fit.model == Model::Newell {
        all.insert(2, ("lambda", "1/h", lambda));
    }
    all
}

fn method(fit: &Fit) -> &'static str {
    if fit.robust { "robust" } else { "least_squares" }
}

/// One JSON object and a line end. An interval that the data do not give is null.
pub(super) fn json(fit: &Fit) -> String {
    let mut values = Map::new();
    let (mut intervals, mut errors) = (Map::new(), Map::new());
    values.insert("model".into(), fit.model.name().into());
    values.insert("method".into(), method(fit).into());
    values.insert("points".into(), fit.points.into());
    for (name, _, estimate) in quantities(fit) {
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
    values.insert("warnings".into(), json!(fit.warnings));
    format!("{}\n", Value::Object(values))
}

/// Lines for people.
pub(super) fn table(fit: &Fit) -> String {
    let mut out = format!("{} by {}, {} points\n", fit.model.name(), method(fit), fit.points);
    for (name, unit, Estimate { value, interval, .. }) in quantities(fit) {
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
    let _ = writeln!(out, "rmse {:.2} km/h, r squared {:.3}", fit.rmse, fit.r_squared);
    out
}
