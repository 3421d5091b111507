//! The files of a report: HTML with its charts inside, PNG, CSV.

use super::charts;
use super::geojson::geojson;
use super::summary::{BINS, Summary};
use super::sums::Mean;
use crate::chart::Drawing;
use crate::html::{escaped, page};
use crate::morning::map::Tiles;
use crate::morning::places::Known;
use crate::morning::{Morning, SiteNow};
use crate::store;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A file's name and content.
pub(super) type File = (String, Vec<u8>);

/// The page, pictures and tables of one site.
pub(super) fn site_files(summary: &Summary, morning: &Morning) -> Vec<File> {
    let mut files = tables(summary);
    let (first, last) = span(summary);
    let now = morning.sites.iter().find(|site| site.site == summary.site);
    let mut body = now.map_or_else(
        || "<nav><a href=\"../../index.html\">All sites</a></nav>\n".to_owned(),
        |site| morning.site_body(site),
    );
    let _ = writeln!(
        body,
        "<h2>Averages</h2>\n<p class=\"muted\">{first} to {last} (UTC), windows of {} s, {} rows. A \
         lighter colour is a higher density; grey is not known.</p>",
        summary.window_s.unwrap_or_default(),
        summary.rows
    );
    for (name, drawing) in charts::of_site(summary) {
        body += &paper(&drawing);
        files.push((format!("{name}.png"), drawing.png()));
    }
    body += "<p>As tables:";
    for (name, _) in files.iter().filter(|(name, _)| name.ends_with(".csv")) {
        let _ = write!(body, " <a href=\"{name}\">{name}</a>");
    }
    body += "</p>\n";
    files.push(("index.html".into(), page(&title(now, &summary.site), &body, None)));
    files
}

/// A chart on white, in the dark as well: its colours are those of its PNG.
fn paper(drawing: &Drawing) -> String {
    format!("<div class=\"paper\">{}</div>\n", drawing.svg())
}

/// Name of a site, for people.
fn title(now: Option<&SiteNow>, site: &str) -> String {
    now.and_then(|now| now.known.place.name.clone())
        .map_or_else(|| site.to_owned(), |name| format!("{name} ({site})"))
}

fn span(summary: &Summary) -> (String, String) {
    let day = |day: Option<&(i64, _)>| store::date(day.map_or(0, |day| day.0));
    (day(summary.days.first()), day(summary.days.last()))
}

fn time(bin: usize) -> String {
    let minute = bin * 24 * 60 / BINS;
    format!("{:02}:{:02}", minute / 60, minute % 60)
}

/// A value and its count; an empty field where nothing is known.
fn value(mean: Mean) -> String {
    mean.value().map_or_else(|| ",0".to_owned(), |value| format!("{value:.4},{}", mean.count))
}

/// The same with the ends of its interval.
fn value_within(mean: Mean) -> String {
    let ends =
        mean.interval().map_or_else(|| ",".to_owned(), |[low, high]| format!("{low:.4},{high:.4}"));
    format!("{},{ends}", value(mean))
}

fn tables(summary: &Summary) -> Vec<File> {
    let lanes = summary.lanes();
    // Writing to a string does not fail.
    let mut day = String::from("time,lane,density_veh_km,windows,low90_veh_km,high90_veh_km\n");
    for (bin, means) in summary.day_by_lane.iter().enumerate() {
        for &lane in &lanes {
            let _ = writeln!(day, "{},{},{}", time(bin), lane + 1, value_within(means[lane]));
        }
    }
    let mut week = String::from("weekday,time,density_veh_km,windows,low90_veh_km,high90_veh_km\n");
    for (weekday, means) in summary.week.iter().enumerate() {
        for (bin, mean) in means.iter().enumerate() {
            let _ = writeln!(week, "{},{},{}", weekday + 1, time(bin), value_within(*mean));
        }
    }
    let mut complete = String::from("date,lane,windows_expected,windows_archived,windows_known\n");
    for (date, windows) in &summary.days {
        for &lane in &lanes {
            let (date, expected) = (store::date(*date), summary.expected());
            let counts = windows[lane];
            let (archived, known) = (counts.archived, counts.known);
            let _ = writeln!(complete, "{date},{},{expected},{archived},{known}", lane + 1);
        }
    }
    let mut files = vec![
        ("average_day_by_lane.csv".to_owned(), day.into_bytes()),
        ("week.csv".to_owned(), week.into_bytes()),
        ("completeness.csv".to_owned(), complete.into_bytes()),
    ];
    files.extend(tables_along(summary));
    files
}

/// Density by position along the lanes.
fn tables_along(summary: &Summary) -> Vec<File> {
    let lanes = summary.lanes_along();
    if lanes.is_empty() {
        return Vec::new();
    }
    let mut road = String::from("lane,position_m,density_veh_km,windows\n");
    let mut day = String::from("time,lane,position_m,density_veh_km,windows\n");
    for &lane in &lanes {
        let along = &summary.along[lane];
        for (cell, mean) in along.means().enumerate() {
            let (place, mean) = (along.position_m(cell), value(mean));
            let _ = writeln!(road, "{},{place:.1},{mean}", lane + 1);
        }
    }
    for bin in 0..BINS {
        for &lane in &lanes {
            let along = &summary.along[lane];
            for (cell, means) in along.day.iter().enumerate() {
                let (place, mean) = (along.position_m(cell), value(means[bin]));
                let _ = writeln!(day, "{},{},{place:.1},{mean}", time(bin), lane + 1);
            }
        }
    }
    vec![
        ("along_the_road.csv".into(), road.into_bytes()),
        ("average_day_by_position.csv".into(), day.into_bytes()),
    ]
}

/// The page over all sites, its table and its map's data.
pub(super) fn index_files(
    summaries: &[Summary],
    morning: &Morning,
    tiles: Option<&Tiles>,
) -> Vec<File> {
    let mut csv = String::from(
        "site,first_day,last_day,days,lanes,archived_pct,known_pct,mean_density_veh_km,\
         low90_veh_km,high90_veh_km\n",
    );
    let places: BTreeMap<String, Known> =
        morning.sites.iter().map(|site| (site.site.clone(), site.known.clone())).collect();
    let unknown = Known::default();
    let mut table = String::from(
        "<table class=\"cards\">\n<thead><tr><th scope=\"col\">site</th>\
         <th scope=\"col\" class=\"text\">where</th><th scope=\"col\">days</th>\
         <th scope=\"col\">lanes</th><th scope=\"col\">archived</th>\
         <th scope=\"col\">with density</th><th scope=\"col\">mean veh/km/lane (90 %)</th></tr>\
         </thead>\n<tbody>\n",
    );
    let mut day = [Mean::default(); BINS];
    let mut week = vec![[Mean::default(); BINS]; 7];
    for summary in summaries {
        let (site, name) = (&summary.site, escaped(&summary.site));
        let place = &places.get(site).unwrap_or(&unknown).place;
        let (first, last) = span(summary);
        let (days, lanes) = (summary.days.len(), summary.lanes().len());
        let [archived, known] = summary.completeness_pct();
        let mut mean = summary.mean().value().map_or(String::new(), |mean| format!("{mean:.2}"));
        let interval = summary.mean().interval();
        let ends = interval.map_or(",".to_owned(), |[low, high]| format!("{low:.2},{high:.2}"));
        let _ = writeln!(
            csv,
            "{site},{first},{last},{days},{lanes},{archived:.2},{known:.2},{mean},{ends}"
        );
        if let Some([low, high]) = interval {
            let _ = write!(mean, " ({low:.1} to {high:.1})");
        }
        let _ = writeln!(
            table,
            "<tr><td><a href=\"sites/{name}/index.html\">{name}</a></td><td class=\"text\" data-label=\"where\">{}</td>\
             <td data-label=\"days\">{days}</td><td data-label=\"lanes\">{lanes}</td>\
             <td data-label=\"archived\">{archived:.1} %</td><td data-label=\"with density\">{known:.1} %</td>\
             <td data-label=\"mean veh/km/lane (90 %)\">{mean}</td></tr>",
            escaped(&place.words().join(", "))
        );
        for (bin, lanes) in summary.day_by_lane.iter().enumerate() {
            let mut site = Mean::default();
            lanes.iter().for_each(|lane| site.add_mean(*lane));
            day[bin].add_mean(site);
        }
        for (all, site) in week.iter_mut().zip(&summary.week) {
            all.iter_mut().zip(site).for_each(|(all, site)| all.add_mean(*site));
        }
    }
    table += "</tbody></table>\n";
    let drawings: [(&str, Drawing); 2] = [
        ("average_day.png", charts::network_day(&day)),
        ("week.png", charts::week("all sites: average week", &week)),
    ];
    let mut body = morning.body(tiles);
    body += "<h2>Averages</h2>\n<p class=\"muted\">Over all days of the report. A lighter colour is a \
             higher density; grey is not known.</p>\n";
    let trouble = morning.trouble_csv();
    let mut files = vec![
        ("trouble.csv".to_owned(), trouble.into_bytes()),
        ("last_day.csv".to_owned(), morning.last_day_csv().into_bytes()),
        ("sites.csv".to_owned(), csv.into_bytes()),
        ("sites.geojson".to_owned(), geojson(summaries, &places)),
    ];
    for (name, drawing) in drawings {
        body += &paper(&drawing);
        files.push((name.to_owned(), drawing.png()));
    }
    body += &table;
    body += "<p>As a table: <a href=\"sites.csv\">sites.csv</a>, \
             <a href=\"trouble.csv\">trouble.csv</a>, as a map's data: \
             <a href=\"sites.geojson\">sites.geojson</a></p>\n";
    files.push(("index.html".into(), page("Traffic density", &body, None)));
    files
}
