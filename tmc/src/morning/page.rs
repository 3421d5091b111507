//! The morning in HTML: all sites on one page, a site on its own.

use super::level::{level, words as level_words};
use super::map::{self, Tiles};
use super::spark::{self, Large};
use super::{LaneNow, Morning, Point, SiteNow};
pub use crate::html::escaped;
use std::fmt::Write;
use verge_messages::Status;

/// Local date and time, `2026-01-05 08:15`.
pub fn clock(ms: i64, offset_ms: i64) -> String {
    // A time beyond the calendar is in other words.
    let text = verge_messages::rfc3339(ms.saturating_add(offset_ms));
    text.get(..16).unwrap_or(&text).replace('T', " ")
}

/// Local time ahead of UTC as text.
fn zone(offset_ms: i64) -> String {
    let minutes = offset_ms / 60_000;
    let sign = if minutes < 0 { '-' } else { '+' };
    format!("UTC{sign}{:02}:{:02}", minutes.abs() / 60, minutes.abs() % 60)
}

/// How long ago, in its largest unit.
fn ago(ms: i64) -> String {
    let minutes = (ms / 60_000).max(0);
    match minutes {
        0..60 => format!("{minutes} min"),
        60..2880 => format!("{} h", minutes / 60),
        _ => format!("{} days", minutes / 1440),
    }
}

/// Name, road and direction of a site, for people.
fn place(site: &SiteNow) -> String {
    escaped(&site.known.place.words().join(", "))
}

/// A level as a coloured letter with its words.
fn badge(letter: char) -> String {
    format!("<span class=\"level {letter}\" title=\"{}\">{letter}</span>", level_words(letter))
}

/// A density with its interval.
fn density(point: Option<&Point>) -> String {
    let known = point.and_then(|point| Some((point.quarter.density?, point.quarter.ci90)));
    match known {
        None => "<span class=\"muted\">not known</span>".into(),
        Some((density, None)) => format!("{density:.1}"),
        Some((density, Some([low, high]))) => {
            format!("{density:.1} <span class=\"muted\">({low:.0} to {high:.0})</span>")
        }
    }
}

/// A density against what is usual, in words.
fn against(point: Option<&Point>) -> String {
    let known = point.and_then(|point| Some((point.quarter.density?, point.band?)));
    let Some((density, band)) = known else { return "<span class=\"muted\">-</span>".into() };
    let share = if band.middle > 1.0 {
        format!(" <span class=\"muted\">({:+.0} %)</span>", (density / band.middle - 1.0) * 100.0)
    } else {
        String::new()
    };
    if density > band.high {
        format!("denser{share}")
    } else if density < band.low {
        format!("thinner{share}")
    } else {
        "as usual".into()
    }
}

impl Morning {
    /// The head of the page: when, how many sites, their levels.
    fn head(&self) -> String {
        let troubled = self.sites.iter().filter(|site| !site.trouble.is_empty()).count();
        let jammed = self.count(|letter| letter == 'E' || letter == 'F');
        let known = self.count(|_| true);
        let mut html = format!(
            "<p class=\"made muted\">As of <b>{}</b> ({}), made at {}.</p>\n<ul class=\"tiles\">\n",
            clock(self.now_ms, self.offset_ms),
            zone(self.offset_ms),
            clock(self.made_ms, self.offset_ms),
        );
        let tile = |class: &str, count: usize, what: &str| {
            format!("<li{class}><b>{count}</b>{what}</li>\n")
        };
        html += &tile("", self.sites.len(), "sites");
        html += &tile(if troubled > 0 { " class=\"bad\"" } else { "" }, troubled, "with trouble");
        html += &tile("", jammed, "at or beyond capacity");
        html += &tile("", known, "with a density now");
        html + "</ul>\n"
    }

    fn count(&self, is_so: impl Fn(char) -> bool) -> usize {
        self.sites
            .iter()
            .filter(|site| site.level().is_some_and(|(_, letter)| is_so(letter)))
            .count()
    }

    /// The table of trouble; a sentence where there is none.
    pub fn trouble(&self) -> String {
        let mut all: Vec<_> = self
            .sites
            .iter()
            .flat_map(|site| site.trouble.iter().map(move |trouble| (trouble, site)))
            .collect();
        all.sort_by(|a, b| (a.0, &a.1.site).cmp(&(b.0, &b.1.site)));
        if all.is_empty() {
            return "<h2>Trouble</h2>\n<p>Nothing is wrong with any site.</p>\n".to_owned();
        }
        let troubled = self.sites.iter().filter(|site| !site.trouble.is_empty()).count();
        let mut html = format!(
            "<h2>Trouble: {troubled} of {} sites</h2>\n<table class=\"cards\">\n<thead><tr>\
             <th scope=\"col\">site</th><th scope=\"col\" class=\"text\">where</th>\
             <th scope=\"col\" class=\"text\">what</th><th scope=\"col\">since</th>\
             <th scope=\"col\">for</th></tr></thead>\n<tbody>\n",
            self.sites.len()
        );
        for (trouble, site) in all {
            let name = escaped(&site.site);
            let _ = writeln!(
                html,
                "<tr><td><a href=\"sites/{name}/index.html\">{name}</a></td>\
                 <td class=\"text\" data-label=\"where\">{}</td>\
                 <td class=\"text bad\" data-label=\"what\">{}</td>\
                 <td class=\"once\" data-label=\"since\">{}</td><td class=\"once\" data-label=\"for\">{}</td></tr>",
                place(site),
                escaped(&trouble.reason),
                clock(trouble.since_ms, self.offset_ms),
                ago(self.now_ms - trouble.since_ms),
            );
        }
        html + "</tbody></table>\n"
    }

    /// Trouble as CSV: the oldest first.
    pub fn trouble_csv(&self) -> String {
        let of = |site: &SiteNow| -> Vec<_> {
            site.trouble.iter().map(|it| (it.clone(), site.site.clone())).collect()
        };
        let mut all: Vec<_> = self.sites.iter().flat_map(of).collect();
        all.sort();
        let mut csv = String::from("site,since,reason\n");
        for (trouble, site) in all {
            let since = verge_messages::rfc3339(trouble.since_ms);
            let _ = writeln!(csv, "{site},{since},\"{}\"", trouble.reason.replace('"', "\"\""));
        }
        csv
    }

    /// The quarter hours of the last day as CSV, with what is usual.
    pub fn last_day_csv(&self) -> String {
        let mut csv = String::from(
            "site,from,density_veh_km,low90_veh_km,high90_veh_km,flow_veh_h,speed_kmh,\
             usual_low_veh_km,usual_middle_veh_km,usual_high_veh_km\n",
        );
        let number = |value: Option<f32>| value.map_or(String::new(), |it| format!("{it:.4}"));
        for site in &self.sites {
            for Point { from_ms, quarter, band } in &site.points {
                let values = [
                    quarter.density,
                    quarter.ci90.map(|[low, _]| low),
                    quarter.ci90.map(|[_, high]| high),
                    quarter.flow,
                    quarter.speed,
                    band.map(|band| band.low),
                    band.map(|band| band.middle),
                    band.map(|band| band.high),
                ];
                let values = values.map(number).join(",");
                let from = verge_messages::rfc3339(*from_ms);
                let _ = writeln!(csv, "{},{from},{values}", site.site);
            }
        }
        csv
    }

    /// The body of the page over all sites.
    pub fn body(&self, tiles: Option<&Tiles>) -> String {
        let mut html = self.head();
        html += &self.trouble();
        let map = map::map(&self.sites, tiles);
        if !map.is_empty() {
            html += "<h2>Map</h2>\n<div class=\"wide\">";
            html += &map;
            html += "</div>\n";
        }
        html += &legend();
        html += "<h2>All sites</h2>\n";
        html += "<ul class=\"legend\"><li><span class=\"swatch line\"></span>density of the last 24 hours\
                 </li><li><span class=\"swatch band\"></span>usual on that weekday: 8 of 10 days lie \
                 in it</li></ul>\n";
        html += "<table class=\"cards\">\n<thead><tr><th scope=\"col\">site</th>\
                 <th scope=\"col\" class=\"text\">where</th><th scope=\"col\">level</th>\
                 <th scope=\"col\">veh/km/lane (90 %)</th><th scope=\"col\">against usual</th>\
                 <th scope=\"col\">veh/h</th><th scope=\"col\">km/h</th>\
                 <th scope=\"col\">last 24 hours</th></tr></thead>\n<tbody>\n";
        for site in &self.sites {
            html += &self.row(site);
        }
        html += "</tbody></table>\n";
        for line in &self.told {
            let _ = writeln!(html, "<p class=\"bad-text\">{}</p>", escaped(line));
        }
        html
    }

    fn row(&self, site: &SiteNow) -> String {
        let (name, now) = (escaped(&site.site), site.now());
        let number = |value: Option<f32>| {
            value.map_or_else(|| "<span class=\"muted\">-</span>".into(), |it| format!("{it:.0}"))
        };
        let letter = site.level().map_or_else(
            || "<span class=\"muted\">-</span>".to_owned(),
            |(lane, letter)| {
                let of = if site.lanes.len() > 1 {
                    format!(" <span class=\"muted\">lane {lane}</span>")
                } else {
                    String::new()
                };
                badge(letter) + &of
            },
        );
        let place = match (place(site), site.trouble.first()) {
            (place, None) => place,
            (place, Some(trouble)) => {
                format!("{place} <span class=\"bad-text\">{}</span>", escaped(&trouble.reason))
            }
        };
        format!(
            "<tr><td><a href=\"sites/{name}/index.html\">{name}</a></td>\
             <td class=\"text\" data-label=\"where\"><span>{place}</span></td>\
             <td data-label=\"level\"><span>{letter}</span></td>\
             <td data-label=\"veh/km/lane (90 %)\"><span>{}</span></td>\
             <td data-label=\"against usual\"><span>{}</span></td>\
             <td data-label=\"veh/h\">{}</td><td data-label=\"km/h\">{}</td>\
             <td data-label=\"last 24 hours\">{}</td></tr>\n",
            density(now),
            against(now),
            number(now.and_then(|point| point.quarter.flow)),
            number(now.and_then(|point| point.quarter.speed)),
            spark::small(site),
        )
    }

    /// The body of a site's own page.
    pub fn site_body(&self, site: &SiteNow) -> String {
        let mut html = format!(
            "<nav><a href=\"../../index.html\">All sites</a></nav>\n\
             <p class=\"made muted\">{}{}As of <b>{}</b> ({}), made at {}; last heard {}.</p>\n",
            place(site),
            if site.known.place.words().is_empty() { "" } else { ". " },
            clock(self.now_ms, self.offset_ms),
            zone(self.offset_ms),
            clock(self.made_ms, self.offset_ms),
            clock(site.heard_ms, self.offset_ms),
        );
        for trouble in &site.trouble {
            let _ = writeln!(
                html,
                "<p class=\"bad-text\">{}, since {} ({})</p>",
                escaped(&trouble.reason),
                clock(trouble.since_ms, self.offset_ms),
                ago(self.now_ms - trouble.since_ms)
            );
        }
        if !site.lanes.is_empty() {
            html += &lanes_table(site);
        }
        for large in [
            Large {
                title: "Density",
                unit: "veh/km/lane, with its 90 % interval, over the band that is usual",
                value: |point| point.quarter.density,
                within: |point| point.quarter.ci90,
                has_band: true,
            },
            Large {
                title: "Flow",
                unit: "veh/h, all lanes",
                value: |point| point.quarter.flow,
                within: |_| None,
                has_band: false,
            },
            Large {
                title: "Speed",
                unit: "km/h, space mean, weighted by flow",
                value: |point| point.quarter.speed,
                within: |_| None,
                has_band: false,
            },
        ] {
            html += &large.svg(site, self.offset_ms);
        }
        html
    }
}

/// Legend of the letters.
fn legend() -> String {
    let mut html = String::from("<ul class=\"legend\" aria-label=\"Levels of service\">\n");
    for (letter, range) in [
        ('A', "to 6.8"),
        ('B', "to 11.2"),
        ('C', "to 16.2"),
        ('D', "to 21.7"),
        ('E', "to 28.0"),
        ('F', "above"),
    ] {
        let _ = writeln!(
            html,
            "<li>{} {} <span class=\"muted\">{range}</span></li>",
            badge(letter),
            level_words(letter)
        );
    }
    html + "</ul>\n<p class=\"muted\">Level of service of the densest lane in the last quarter of an \
            hour, veh/km/lane (Highway Capacity Manual, 6th edition, Exhibit 12-15; lorries count as \
            one vehicle).</p>\n"
}

fn lanes_table(site: &SiteNow) -> String {
    let mut html = String::from(
        "<h2>Lanes, the last quarter of an hour</h2>\n<table class=\"cards\">\n<thead><tr>\
         <th scope=\"col\">lane</th><th scope=\"col\">level</th>\
         <th scope=\"col\">veh/km (90 %)</th><th scope=\"col\">veh/h</th><th scope=\"col\">km/h</th>\
         <th scope=\"col\" class=\"text\">status</th></tr></thead>\n<tbody>\n",
    );
    for LaneNow { lane, quarter, status } in &site.lanes {
        let name = site.known.lanes.get(lane).map_or_else(String::new, |name| {
            format!(" <span class=\"muted\">{}</span>", escaped(name))
        });
        let number = |value: Option<f32>| {
            value.map_or_else(|| "<span class=\"muted\">-</span>".into(), |it| format!("{it:.0}"))
        };
        let point = Point { from_ms: 0, quarter: *quarter, band: None };
        let known = Status::ALL.into_iter().find(|it| i32::from(it.number()) == *status);
        let is_ok = known == Some(Status::Ok);
        let _ = writeln!(
            html,
            "<tr><td>{lane}{name}</td><td data-label=\"level\">{}</td>\
             <td data-label=\"veh/km (90 %)\"><span>{}</span></td><td data-label=\"veh/h\">{}</td>\
             <td data-label=\"km/h\">{}</td>\
             <td class=\"text{}\" data-label=\"status\">{}</td></tr>",
            quarter.density.map_or_else(|| "-".to_owned(), |density| badge(level(density))),
            density(Some(&point)),
            number(quarter.flow),
            number(quarter.speed),
            if is_ok { "" } else { " bad" },
            known.map_or("unknown", Status::name),
        );
    }
    html + "</tbody></table>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_local_and_durations_round_down() {
        assert_eq!(clock(1_767_600_000_000, 8 * 3_600_000), "2026-01-05 16:00");
        assert_eq!((zone(0), zone(-12_600_000)), ("UTC+00:00".into(), "UTC-03:30".into()));
        let minute = 60_000;
        assert_eq!((ago(59 * minute), ago(119 * minute)), ("59 min".into(), "1 h".into()));
        assert_eq!((ago(2879 * minute), ago(2880 * minute)), ("47 h".into(), "2 days".into()));
    }
}
