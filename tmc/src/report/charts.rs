//! The charts of a report: average day, week, density along the road, completeness.

use super::summary::{BINS, LANES, Summary};
use super::sums::Mean;
use crate::chart::axes::{Tick, round_ticks};
use crate::chart::{Anchor, Axes, Colour, Drawing, Shape, UNKNOWN, shade};
use crate::store;

const WIDTH: u32 = 860;
/// Width of the colour scale beside a map.
const SCALE: f64 = 90.0;
const DENSITY: &str = "density, veh/km/lane";
const WEEKDAYS: [&str; 7] = ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"];
/// One colour a lane, told apart also by those who do not see red and green.
const LANE_COLOURS: [Colour; LANES] = [
    Colour(0, 114, 178, 1.0),
    Colour(230, 159, 0, 1.0),
    Colour(0, 158, 115, 1.0),
    Colour(204, 121, 167, 1.0),
    Colour(86, 180, 233, 1.0),
    Colour(213, 94, 0, 1.0),
    Colour(120, 120, 30, 1.0),
    Colour(60, 60, 60, 1.0),
];

/// A chart with the name of its file.
pub(super) type Chart = (String, Drawing);

/// The charts of a site.
pub(super) fn of_site(summary: &Summary) -> Vec<Chart> {
    let mut charts = vec![("average_day".to_owned(), average_day(summary))];
    charts.push(("average_day_by_lane".into(), day_by_lane(summary)));
    charts.push(("week".into(), week(&format!("{}: average week", summary.site), &summary.week)));
    let lanes = summary.lanes_along();
    if !lanes.is_empty() {
        charts.push(("along_the_road".into(), along_the_road(summary)));
    }
    // One scale for all lanes, so that their colours can be compared.
    let top = lanes.iter().map(|&lane| highest(&summary.along[lane].day)).fold(1.0, f64::max);
    for lane in lanes {
        let name = format!("average_day_by_position_lane_{}", lane + 1);
        charts.push((name, day_by_position(summary, lane, top)));
    }
    charts.push(("completeness".into(), completeness(summary)));
    charts
}

fn hours() -> Vec<Tick> {
    (0..=8).map(|i| (f64::from(i) * 3.0, format!("{:02}:00", i * 3))).collect()
}

fn highest(rows: &[[Mean; BINS]]) -> f64 {
    rows.iter().flatten().filter_map(|mean| mean.value()).fold(1.0, f64::max)
}

/// The axis beside the rows of a map.
struct Side<'a> {
    name: &'a str,
    /// Lowest and highest value.
    range: [f64; 2],
    ticks: Vec<Tick>,
}

/// A map of rows over the time of day, row 0 below, with its colour scale from 0 to `top`.
fn map(title: &str, rows: &[[Mean; BINS]], side: Side<'_>, top: f64) -> Drawing {
    let Side { name, range: y, ticks } = side;
    let height = (rows.len() as u32 * 26 + 90).clamp(170, 460);
    let width = WIDTH - SCALE as u32;
    let mut axes = Axes::new([width, height], [0.0, 24.0], y);
    let row_height = (y[1] - y[0]) / rows.len() as f64;
    for (row, bins) in rows.iter().enumerate() {
        let low = y[0] + row as f64 * row_height;
        for (bin, mean) in bins.iter().enumerate() {
            let begin = bin as f64 * 24.0 / BINS as f64;
            let end = (bin + 1) as f64 * 24.0 / BINS as f64;
            let colour = mean.value().map_or(UNKNOWN, |value| shade(value / top));
            axes.cell([begin, low], [end, low + row_height], colour);
        }
    }
    axes.labels_at(title, ["time of day", name], [hours(), ticks], false);
    let mut whole = Drawing::new(WIDTH, height);
    whole.place(axes.finish(), [0.0, 0.0]);
    scale(&mut whole, f64::from(width) + 6.0, top);
    whole
}

/// The colour scale from 0 to `top` at the right of a map.
fn scale(drawing: &mut Drawing, left: f64, top: f64) {
    let (upper, lower) = (40.0, f64::from(drawing.height) - 46.0);
    let steps = 40;
    let step = (lower - upper) / f64::from(steps);
    for i in 0..steps {
        let y = lower - f64::from(i + 1) * step;
        let colour = shade((f64::from(i) + 0.5) / f64::from(steps));
        drawing.shapes.push(Shape::Rectangle([left, y, 14.0, step + 0.6], colour));
    }
    for (value, text) in round_ticks([0.0, top]).into_iter().step_by(2) {
        let y = lower - value / top * (lower - upper);
        drawing.text(text, [left + 19.0, y + 4.0], 11.0, Anchor::Start);
    }
    drawing.text("veh/km", [left - 2.0, 28.0], 11.0, Anchor::Start);
}

/// A curve a lane over the time of day, with a band where the interval is known.
fn average_day(summary: &Summary) -> Drawing {
    let lanes = summary.lanes();
    let hour = |bin: usize| (bin as f64 + 0.5) * 24.0 / BINS as f64;
    let of = |lane: usize| (0..BINS).map(move |bin| (hour(bin), summary.day_by_lane[bin][lane]));
    // A curve ends where nothing is known.
    let curves = |lane: usize| -> Vec<Vec<(f64, Mean)>> {
        let all: Vec<_> = of(lane).collect();
        let runs = all.split(|(_, mean)| mean.count == 0).filter(|run| !run.is_empty());
        runs.map(<[_]>::to_vec).collect()
    };
    let ends = |mean: Mean| mean.interval().map(|[_, high]| high).or(mean.value());
    let highest = lanes
        .iter()
        .flat_map(|&lane| of(lane))
        .filter_map(|(_, mean)| ends(mean))
        .fold(1.0, f64::max);
    let top = highest * (1.1 + 0.08 * lanes.len() as f64);
    let mut axes = Axes::new([WIDTH, 320], [0.0, 24.0], [0.0, top]);
    let title = format!("{}: average day, with the interval of 90 %", summary.site);
    axes.labels_at(&title, ["time of day", DENSITY], [hours(), round_ticks([0.0, top])], true);
    for &lane in &lanes {
        let Colour(red, green, blue, _) = LANE_COLOURS[lane];
        for run in curves(lane) {
            let ends =
                |(hour, mean): &(f64, Mean)| mean.interval().map(|[low, high]| [*hour, low, high]);
            for known in run.split(|it| ends(it).is_none()).filter(|known| !known.is_empty()) {
                let band: Vec<_> = known.iter().filter_map(ends).collect();
                axes.band(&band, Colour(red, green, blue, 0.18));
            }
        }
    }
    for (row, &lane) in lanes.iter().enumerate() {
        for run in curves(lane) {
            let points: Vec<_> =
                run.iter().filter_map(|(hour, mean)| Some([*hour, mean.value()?])).collect();
            axes.curve(&points, 2.0, LANE_COLOURS[lane]);
        }
        axes.key(row, &format!("lane {}", lane + 1), LANE_COLOURS[lane]);
    }
    axes.finish()
}

fn day_by_lane(summary: &Summary) -> Drawing {
    let lanes = summary.lanes();
    let rows: Vec<[Mean; BINS]> = lanes
        .iter()
        .map(|&lane| std::array::from_fn(|bin| summary.day_by_lane[bin][lane]))
        .collect();
    let ticks = lanes.iter().enumerate().map(|(i, lane)| (i as f64 + 0.5, format!("{}", lane + 1)));
    let title = format!("{}: average day by lane", summary.site);
    let range = [0.0, rows.len() as f64];
    let side = Side { name: "lane", range, ticks: ticks.collect() };
    map(&title, &rows, side, highest(&rows))
}

fn day_by_position(summary: &Summary, lane: usize, top: f64) -> Drawing {
    let along = &summary.along[lane];
    let range = [0.0, along.position_m(along.day.len())];
    let title = format!("{}: average day along lane {}", summary.site, lane + 1);
    let side = Side { name: "from upstream end, m", range, ticks: round_ticks(range) };
    map(&title, &along.day, side, top)
}

/// Weekday over time of day, Monday on top.
pub(super) fn week(title: &str, week: &[[Mean; BINS]]) -> Drawing {
    let rows: Vec<[Mean; BINS]> = week.iter().rev().copied().collect();
    let ticks = WEEKDAYS.iter().rev().enumerate();
    let ticks = ticks.map(|(i, name)| (i as f64 + 0.5, (*name).to_owned())).collect();
    map(title, &rows, Side { name: "weekday", range: [0.0, 7.0], ticks }, highest(&rows))
}

fn along_the_road(summary: &Summary) -> Drawing {
    let lanes = summary.lanes_along();
    let curve = |lane: usize| -> Vec<[f64; 2]> {
        let along = &summary.along[lane];
        let middle = |cell: usize| along.position_m(cell) + f64::from(along.cell_m) / 2.0;
        let point = |(cell, mean): (usize, Mean)| Some([middle(cell), mean.value()?]);
        along.means().enumerate().filter_map(point).collect()
    };
    let curves: Vec<_> = lanes.iter().map(|&lane| (lane, curve(lane))).collect();
    let ends = lanes.iter().map(|&lane| &summary.along[lane]);
    let end = ends.map(|along| along.position_m(along.day.len())).fold(1.0, f64::max);
    let highest = curves.iter().flat_map(|(_, points)| points).map(|p| p[1]).fold(1.0, f64::max);
    // Room for the key above the curves.
    let top = highest * (1.1 + 0.08 * lanes.len() as f64);
    let mut axes = Axes::new([WIDTH, 320], [0.0, end], [0.0, top]);
    let title = format!("{}: mean density along the road", summary.site);
    axes.labels(&title, ["from upstream end, m", DENSITY]);
    for (row, (lane, points)) in curves.iter().enumerate() {
        axes.curve(points, 2.0, LANE_COLOURS[*lane]);
        axes.key(row, &format!("lane {}", lane + 1), LANE_COLOURS[*lane]);
    }
    axes.finish()
}

fn completeness(summary: &Summary) -> Drawing {
    let first = summary.days.first().map_or(0, |day| day.0);
    let last = summary.days.last().map_or(0, |day| day.0);
    let span = (last - first + 1) as f64;
    let mut axes = Axes::new([WIDTH, 240], [0.0, span], [0.0, 100.0]);
    for (day, windows) in &summary.days {
        let [archived, known] = summary.completeness(windows);
        let (begin, end) = ((day - first) as f64, (day - first + 1) as f64);
        axes.cell([begin, 0.0], [end, archived * 100.0], Colour(190, 205, 225, 1.0));
        axes.cell([begin, 0.0], [end, known * 100.0], Colour(50, 95, 160, 1.0));
    }
    let ticks = round_ticks([0.0, span])
        .into_iter()
        .filter(|(at, _)| at.fract() == 0.0 && *at < span)
        .map(|(at, _)| (at + 0.5, store::date(first + at as i64)[5..].to_owned()))
        .collect();
    let title = format!("{}: windows archived (pale) and with a density (dark)", summary.site);
    let labels = ["day (UTC)", "per cent"];
    axes.labels_at(&title, labels, [ticks, round_ticks([0.0, 100.0])], false);
    axes.finish()
}

/// The average day of the whole network: the mean of the sites' means.
pub(super) fn network_day(day: &[Mean; BINS]) -> Drawing {
    let points: Vec<[f64; 2]> = day
        .iter()
        .enumerate()
        .filter_map(|(bin, mean)| Some([(bin as f64 + 0.5) * 24.0 / BINS as f64, mean.value()?]))
        .collect();
    let top = points.iter().map(|p| p[1]).fold(1.0, f64::max) * 1.1;
    let mut axes = Axes::new([WIDTH, 280], [0.0, 24.0], [0.0, top]);
    let ticks = [hours(), round_ticks([0.0, top])];
    axes.labels_at("all sites: average day", ["time of day", DENSITY], ticks, true);
    axes.curve(&points, 2.0, LANE_COLOURS[0]);
    axes.finish()
}
