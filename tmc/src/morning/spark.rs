//! The last 24 hours of a site as SVG: what is usual as a band, what was measured as a line.
//!
//! Colours are the page's (classes), so that light and dark and paper have their own.

use super::{Point, SiteNow};
use std::fmt::Write;

/// Width of a quarter of an hour, units of the drawing.
const STEP: f64 = 3.0;
/// The lowest top of the scale, veh/km/lane: an empty road must not zigzag.
const LEAST_TOP: f64 = 15.0;

/// A small chart for a table.
pub(super) fn small(site: &SiteNow) -> String {
    chart(site, 44.0, &words(site))
}

/// A picture of the site's last day in words, for those who do not see it.
pub(super) fn words(site: &SiteNow) -> String {
    let now = site.now().and_then(|point| Some((point, point.quarter.density?)));
    let Some((point, density)) = now else {
        return "last 24 hours; nothing is known of now".into();
    };
    let usual = point.band.map_or_else(
        || "too few weeks to say what is usual".to_owned(),
        |band| format!("usual are {:.0} to {:.0}", band.low, band.high),
    );
    format!("last 24 hours; now {density:.0} vehicles per kilometre and lane, {usual}")
}

fn chart(site: &SiteNow, height: f64, title: &str) -> String {
    let points = &site.points;
    let width = points.len() as f64 * STEP;
    let highest = points
        .iter()
        .flat_map(|it| [it.quarter.density, it.band.map(|band| band.high)])
        .flatten()
        .fold(0.0f32, f32::max);
    let top = LEAST_TOP.max(f64::from(highest) * 1.05);
    let y = |value: f32| height - 1.0 - f64::from(value) / top * (height - 2.0);
    let x = |index: usize| (index as f64 + 0.5) * STEP;
    let mut svg = format!(
        "<svg class=\"spark\" viewBox=\"0 0 {width} {height}\" preserveAspectRatio=\"none\" \
         role=\"img\" aria-label=\"{title}\">"
    );
    for run in runs(points, |point| point.band.is_some()) {
        let mut outline = String::new();
        for (index, point) in &run {
            let high = point.band.map_or(0.0, |band| band.high);
            let _ = write!(outline, "{:.1},{:.1} ", x(*index), y(high));
        }
        for (index, point) in run.iter().rev() {
            let low = point.band.map_or(0.0, |band| band.low);
            let _ = write!(outline, "{:.1},{:.1} ", x(*index), y(low));
        }
        let _ = write!(svg, "<polygon class=\"band\" points=\"{}\"/>", outline.trim_end());
    }
    for run in runs(points, |point| point.quarter.density.is_some()) {
        let mut line = String::new();
        for (index, point) in &run {
            let density = point.quarter.density.unwrap_or_default();
            let _ = write!(line, "{:.1},{:.1} ", x(*index), y(density));
        }
        let _ = write!(svg, "<polyline class=\"line\" points=\"{}\"/>", line.trim_end());
    }
    svg.push_str("</svg>");
    svg
}

/// Successive points of which something is known, with their numbers.
fn runs(points: &[Point], is_known: impl Fn(&Point) -> bool) -> Vec<Vec<(usize, &Point)>> {
    let all: Vec<(usize, &Point)> = points.iter().enumerate().collect();
    all.split(|(_, point)| !is_known(point))
        .filter(|run| !run.is_empty())
        .map(<[_]>::to_vec)
        .collect()
}

/// A large chart of one quantity, with scales and hours.
pub(super) struct Large<'a> {
    pub(super) title: &'a str,
    pub(super) unit: &'a str,
    pub(super) value: fn(&Point) -> Option<f32>,
    /// Interval of a value.
    pub(super) within: fn(&Point) -> Option<[f32; 2]>,
    /// Whether the band of what is usual is of this quantity.
    pub(super) has_band: bool,
}

const LEFT: f64 = 44.0;
const BOTTOM: f64 = 22.0;
const HEIGHT: f64 = 210.0;
const WIDE: f64 = 7.0;

impl Large<'_> {
    /// The chart; empty where nothing is known.
    pub(super) fn svg(&self, site: &SiteNow, offset_ms: i64) -> String {
        let points = &site.points;
        let ends = |point: &Point| (self.within)(point).map(|[_, high]| high);
        let band = |point: &Point| point.band.filter(|_| self.has_band);
        let highest = points
            .iter()
            .flat_map(|it| [(self.value)(it), ends(it), band(it).map(|band| band.high)])
            .flatten()
            .fold(0.0f32, f32::max);
        if points.iter().all(|point| (self.value)(point).is_none()) {
            return String::new();
        }
        let ticks = crate::chart::axes::round_ticks([0.0, f64::from(highest.max(1.0)) * 1.05]);
        let top = f64::from(highest.max(1.0)) * 1.05;
        let width = LEFT + points.len() as f64 * WIDE + 8.0;
        let y = |value: f64| 8.0 + (1.0 - value / top) * (HEIGHT - 8.0 - BOTTOM);
        let x = |index: usize| LEFT + (index as f64 + 0.5) * WIDE;
        let mut svg = format!(
            "<figure><figcaption>{} <span class=\"muted\">{}</span></figcaption><div class=\"wide\">\
             <svg class=\"large\" viewBox=\"0 0 {width} {HEIGHT}\" role=\"img\" \
             aria-label=\"{}: last 24 hours\">",
            self.title, self.unit, self.title
        );
        for (value, text) in ticks {
            let _ = write!(
                svg,
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{:.0}\" y1=\"{:.1}\" y2=\"{:.1}\"/>\
                 <text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
                width - 8.0,
                y(value),
                y(value),
                LEFT - 6.0,
                y(value) + 4.0
            );
        }
        for (index, point) in points.iter().enumerate() {
            let local = super::page::clock(point.from_ms, offset_ms);
            if let Some(hour) = local.get(11..).filter(|clock| clock.ends_with(":00")) {
                let is_labelled = hour[..2].parse::<u32>().is_ok_and(|hour| hour % 3 == 0);
                if is_labelled {
                    let _ = write!(
                        svg,
                        "<line class=\"grid\" x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"8\" y2=\"{1:.0}\"/>\
                         <text x=\"{0:.1}\" y=\"{2:.0}\" text-anchor=\"middle\">{hour}</text>",
                        x(index) - WIDE / 2.0,
                        HEIGHT - BOTTOM,
                        HEIGHT - 6.0
                    );
                }
            }
        }
        type Ends<'a> = Box<dyn Fn(&Point) -> Option<[f32; 2]> + 'a>;
        let areas: [(&str, Ends<'_>); 2] = [
            ("band", Box::new(move |point| band(point).map(|band| [band.low, band.high]))),
            ("within", Box::new(|point| (self.within)(point))),
        ];
        for (class, area) in areas {
            for run in runs(points, |point| area(point).is_some()) {
                let corner = |(index, point): &(usize, &Point), end: usize| {
                    let value = area(point).map_or(0.0, |ends| ends[end]);
                    format!("{:.1},{:.1} ", x(*index), y(f64::from(value)))
                };
                let mut outline: String = run.iter().map(|it| corner(it, 1)).collect();
                outline.extend(run.iter().rev().map(|it| corner(it, 0)));
                let _ =
                    write!(svg, "<polygon class=\"{class}\" points=\"{}\"/>", outline.trim_end());
            }
        }
        for run in runs(points, |point| (self.value)(point).is_some()) {
            let corner = |(index, point): &(usize, &Point)| {
                let value = (self.value)(point).unwrap_or_default();
                format!("{:.1},{:.1} ", x(*index), y(f64::from(value)))
            };
            let line: String = run.iter().map(corner).collect();
            let _ = write!(svg, "<polyline class=\"line\" points=\"{}\"/>", line.trim_end());
        }
        svg.push_str("</svg></div></figure>\n");
        svg
    }
}
