//! The files of a report: HTML with its charts inside, PNG, CSV.

use super::charts;
use super::places::{self, Place, Places};
use super::queries::BINS;
use super::summary::{Mean, Summary};
use super::trouble::Trouble;
use crate::chart::Drawing;
use crate::store;
use std::fmt::Write;

/// A file's name and content.
pub(super) type File = (String, Vec<u8>);

const STYLE: &str = "body{font-family:sans-serif;color:#282828;max-width:900px;margin:24px auto;\
    padding:0 16px}table{border-collapse:collapse}td,th{padding:3px 12px;text-align:right;\
    border-bottom:1px solid #ddd}td:first-child,th:first-child,.text{text-align:left}\
    svg{max-width:100%;height:auto;margin:8px 0}a{color:#325fa0}";

/// Text for HTML, in content and in quoted attributes.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
        .replace('\'', "&#39;")
}

/// A page with a title and a body.
fn page(title: &str, body: &str) -> Vec<u8> {
    let title = escaped(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title}</title>\n\
         <style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{body}</body>\n</html>\n"
    )
    .into_bytes()
}

/// The page, pictures and tables of one site.
pub(super) fn site_files(summary: &Summary, place: Option<&Place>) -> Vec<File> {
    let mut files = tables(summary);
    let (first, last) = span(summary);
    let mut body = format!(
        "<p><a href=\"../../index.html\">All sites</a>. {first} to {last} (UTC), windows of {} s, \
         {} rows. A lighter colour is a higher density; grey is not known.</p>\n",
        summary.window_s.unwrap_or_default(),
        summary.rows
    );
    let words = place.map_or_else(Vec::new, |place| place.words());
    if !words.is_empty() {
        let _ = writeln!(body, "<p>{}</p>", escaped(&words.join(", ")));
    }
    for (name, drawing) in charts::of_site(summary) {
        body += &drawing.svg();
        files.push((format!("{name}.png"), drawing.png()));
    }
    body += "<p>As tables:";
    for (name, _) in files.iter().filter(|(name, _)| name.ends_with(".csv")) {
        let _ = write!(body, " <a href=\"{name}\">{name}</a>");
    }
    body += "</p>\n";
    files.push(("index.html".into(), page(&summary.site, &body)));
    files
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

/// What is told by position along the lanes.
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
pub(super) fn index_files(summaries: &[Summary], places: &Places) -> Vec<File> {
    let mut csv = String::from(
        "site,first_day,last_day,days,lanes,archived_pct,known_pct,mean_density_veh_km,\
         low90_veh_km,high90_veh_km\n",
    );
    let unknown = Place::default();
    let mut table = String::from(
        "<table>\n<tr><th>site</th><th class=\"text\">where</th><th>days</th><th>lanes</th>\
         <th>archived</th>\
         <th>with density</th><th>mean veh/km/lane (90 %)</th></tr>\n",
    );
    let mut day = [Mean::default(); BINS];
    let mut week = vec![[Mean::default(); BINS]; 7];
    for summary in summaries {
        let (site, name) = (&summary.site, escaped(&summary.site));
        let place = places.get(site).unwrap_or(&unknown);
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
            "<tr><td><a href=\"sites/{name}/index.html\">{name}</a></td><td class=\"text\">{}</td>\
             <td>{days}</td><td>{lanes}</td>\
             <td>{archived:.1} %</td><td>{known:.1} %</td><td>{mean}</td></tr>",
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
    table += "</table>\n";
    let drawings: [(&str, Drawing); 2] = [
        ("average_day.png", charts::network_day(&day)),
        ("week.png", charts::week("all sites: average week", &week)),
    ];
    let (mut body, trouble) = trouble(summaries, places);
    let mut files = vec![
        ("trouble.csv".to_owned(), trouble.into_bytes()),
        ("sites.csv".to_owned(), csv.into_bytes()),
        ("sites.geojson".to_owned(), places::geojson(summaries, places)),
    ];
    for (name, drawing) in drawings {
        body += &drawing.svg();
        files.push((name.to_owned(), drawing.png()));
    }
    body += &table;
    body += "<p>As a table: <a href=\"sites.csv\">sites.csv</a>, \
             <a href=\"trouble.csv\">trouble.csv</a>, as a map's data: \
             <a href=\"sites.geojson\">sites.geojson</a></p>\n";
    files.push(("index.html".into(), page("Traffic density", &body)));
    files
}

/// What is wrong with which site, the oldest first: for the page, and as a table.
fn trouble(summaries: &[Summary], places: &Places) -> (String, String) {
    let mut csv = String::from("site,since,reason\n");
    let of =
        |site: &Summary| site.trouble.iter().map(|it| (it.clone(), site.site.clone())).collect();
    let mut all: Vec<(Trouble, String)> = summaries.iter().flat_map::<Vec<_>, _>(of).collect();
    all.sort();
    if all.is_empty() {
        return ("<p>Nothing is wrong with any site.</p>\n".to_owned(), csv);
    }
    let mut sites: Vec<&str> = all.iter().map(|(_, site)| site.as_str()).collect();
    sites.sort_unstable();
    sites.dedup();
    let mut table = format!(
        "<h2>Trouble: {} of {} sites</h2>\n<table>\n<tr><th>site</th><th class=\"text\">where</th>\
         <th>since (UTC)</th><th class=\"text\">what</th></tr>\n",
        sites.len(),
        summaries.len()
    );
    for (Trouble { since_ms, reason }, site) in &all {
        let since = verge_messages::rfc3339(*since_ms);
        let (name, place) = (escaped(site), places.get(site).map(Place::words).unwrap_or_default());
        let _ = writeln!(csv, "{site},{since},\"{reason}\"");
        let _ = writeln!(
            table,
            "<tr><td><a href=\"sites/{name}/index.html\">{name}</a></td>\
             <td class=\"text\">{}</td><td>{}</td><td class=\"text\">{reason}</td></tr>",
            escaped(&place.join(", ")),
            since[..16].replace('T', " ")
        );
    }
    (table + "</table>\n<h2>All sites</h2>\n", csv)
}
