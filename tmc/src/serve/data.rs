//! The archive's numbers as JSON, for programs that draw: Grafana's Infinity data source, a notebook.
//!
//! Owns what may be asked for and the rows that come back: sites as they are this morning, and means
//! of one site over steps of time, read from Parquet when they are asked for. What is not known is
//! null. A time is what Grafana sends and takes: ms since 1970.

use crate::message::is_site;
use crate::morning::Morning;
use crate::morning::day::{BIN_MS, Day, Quarter, Reading};
use crate::morning::level::level;
use crate::store::{DAY_MS, Partition};
use serde_json::{Value, json};
use std::path::Path;

/// Longest time that is asked for at once, days: a year and a day.
const MOST_DAYS: i64 = 367;
/// Most rows of an answer, some MB.
const MOST_ROWS: i64 = 50_000;
/// Longest step.
const LONGEST_STEP_MS: i64 = 7 * DAY_MS;

/// Why there is no answer: the status of HTTP, and words.
#[derive(Debug, PartialEq, Eq)]
pub struct Refusal(pub u16, pub String);

/// The answer to `/data/NAME?QUERY`; none where there is no such name.
pub fn answer(
    name: &str,
    query: &str,
    morning: &Morning,
    archive: &Path,
) -> Option<Result<Value, Refusal>> {
    match name {
        "sites" => Some(Ok(sites(morning))),
        "density" => Some(Asked::of(query, morning).and_then(|asked| asked.density(archive))),
        _ => None,
    }
}

/// Every site: where it is, its latest quarter of an hour, and its oldest trouble.
fn sites(morning: &Morning) -> Value {
    let row = |site: &crate::morning::SiteNow| {
        let (place, now) = (&site.known.place, site.now().map(|point| point.quarter));
        let trouble = site.trouble.first();
        json!({
            "site": site.site,
            "name": place.name,
            "road": place.road,
            "direction": place.direction,
            "latitude": place.latitude,
            "longitude": place.longitude,
            "heard": site.heard_ms,
            "density_veh_km": now.and_then(|it| it.density),
            "flow_veh_h": now.and_then(|it| it.flow),
            "speed_kmh": now.and_then(|it| it.speed),
            "level_of_service": site.level().map(|(_, letter)| letter.to_string()),
            "trouble": trouble.map(|it| &it.reason),
            "since": trouble.map(|it| it.since_ms),
        })
    };
    morning.sites.iter().map(row).collect()
}

/// A request: a site from one time to another, in steps, of all lanes or of one.
#[derive(Debug, PartialEq, Eq)]
struct Asked {
    site: String,
    from_ms: i64,
    to_ms: i64,
    step_ms: i64,
    lane: Option<i32>,
}

impl Asked {
    fn of(query: &str, morning: &Morning) -> Result<Self, Refusal> {
        let (mut site, mut from, mut to, mut step, mut lane) = (None, None, None, None, None);
        for (key, value) in query.split('&').filter_map(|pair| pair.split_once('=')) {
            match key {
                "site" => site = Some(value.to_owned()),
                "from" => from = Some(number(key, value)?),
                "to" => to = Some(number(key, value)?),
                "step_ms" => step = Some(number(key, value)?),
                "lane" => lane = Some(number(key, value)?),
                _ => return Err(wrong(format!("{key:?}: ask by site, from, to, step_ms, lane"))),
            }
        }
        let missing = |key: &str| wrong(format!("{key} is missing: site=NAME&from=MS&to=MS"));
        let site: String = site.ok_or_else(|| missing("site"))?;
        let (from_ms, to_ms) =
            (from.ok_or_else(|| missing("from"))?, to.ok_or_else(|| missing("to"))?);
        if !is_site(&site) || !morning.sites.iter().any(|known| known.site == site) {
            return Err(Refusal(
                404,
                format!("{site:?} is not in the archive: look at /data/sites"),
            ));
        }
        if !(0..=MOST_DAYS * DAY_MS).contains(&(to_ms - from_ms)) {
            return Err(wrong(format!("to is after from by at most {MOST_DAYS} days")));
        }
        // Whole quarters of an hour, which a day has a whole number of.
        let step_ms = (step.unwrap_or(BIN_MS).clamp(1, LONGEST_STEP_MS) + BIN_MS - 1) / BIN_MS;
        let step_ms = step_ms * BIN_MS;
        if (to_ms - from_ms) / step_ms > MOST_ROWS {
            return Err(wrong(format!("more than {MOST_ROWS} rows: give a longer step_ms")));
        }
        let lane = lane.map(|lane| i32::try_from(lane).unwrap_or(i32::MAX));
        Ok(Self { site, from_ms, to_ms, step_ms, lane })
    }

    /// Means over steps, those with a window.
    fn density(&self, archive: &Path) -> Result<Value, Refusal> {
        let mut rows = Vec::new();
        // Readings of the step that is not over.
        let mut open: Vec<Reading> = Vec::new();
        let step = |reading: &Reading| reading.from_ms.div_euclid(self.step_ms);
        for day in self.from_ms.div_euclid(DAY_MS)..=self.to_ms.div_euclid(DAY_MS) {
            let path = Partition { site: self.site.clone(), day }.path(archive);
            if !path.exists() {
                continue;
            }
            let read = Day::read(&path).map_err(|failure| Refusal(500, failure.to_string()))?;
            let asked = |it: &Reading| {
                (self.from_ms..self.to_ms).contains(&it.from_ms)
                    && self.lane.is_none_or(|lane| it.lane == lane)
            };
            for reading in read.readings.into_iter().filter(asked) {
                if open.first().is_some_and(|first| step(first) != step(&reading)) {
                    rows.push(self.row(&open));
                    open.clear();
                }
                open.push(reading);
            }
        }
        if !open.is_empty() {
            rows.push(self.row(&open));
        }
        Ok(rows.into())
    }

    fn row(&self, readings: &[Reading]) -> Value {
        let Quarter { density, ci90, flow, speed } = Quarter::of(readings);
        json!({
            "time": readings[0].from_ms.div_euclid(self.step_ms) * self.step_ms,
            "density_veh_km": density,
            "low90_veh_km": ci90.map(|[low, _]| low),
            "high90_veh_km": ci90.map(|[_, high]| high),
            "flow_veh_h": flow,
            "speed_kmh": speed,
            "level_of_service": density.map(|density| level(density).to_string()),
        })
    }
}

fn wrong(reason: String) -> Refusal {
    Refusal(400, reason)
}

fn number(key: &str, value: &str) -> Result<i64, Refusal> {
    // Of times after 1970, and before the year 10000.
    let number = value.parse().ok().filter(|number| (0..=253_402_300_800_000).contains(number));
    number.ok_or_else(|| wrong(format!("{key}={value}: give a whole number, not below 0")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::morning::SiteNow;
    use crate::morning::places::Known;

    fn morning() -> Morning {
        let site = SiteNow {
            site: "north".into(),
            known: Known::default(),
            trouble: Vec::new(),
            heard_ms: 7,
            lanes: Vec::new(),
            points: Vec::new(),
        };
        Morning { made_ms: 0, now_ms: 0, offset_ms: 0, sites: vec![site], told: Vec::new() }
    }

    fn refused(query: &str) -> Refusal {
        Asked::of(query, &morning()).unwrap_err()
    }

    #[test]
    fn what_is_asked_for_is_held_to_its_bounds() {
        let asked = Asked::of("site=north&from=900000&to=9900000&step_ms=1&lane=2", &morning());
        let expected = Asked {
            site: "north".into(),
            from_ms: 900_000,
            to_ms: 9_900_000,
            step_ms: BIN_MS,
            lane: Some(2),
        };
        assert_eq!(asked, Ok(expected));
        let step = |ms: &str| {
            let query = format!("site=north&from=0&to=1&step_ms={ms}");
            Asked::of(&query, &morning()).unwrap().step_ms
        };
        assert_eq!((step("900001"), step("99999999999")), (2 * BIN_MS, LONGEST_STEP_MS));
        for (query, status, said) in [
            ("", 400, "site is missing"),
            ("site=north&from=1", 400, "to is missing"),
            ("site=south&from=1&to=2", 404, "/data/sites"),
            ("site=../../etc&from=1&to=2", 404, "/data/sites"),
            ("site=north&from=2&to=1", 400, "to is after from"),
            ("site=north&from=0&to=31708800001", 400, "at most 367 days"),
            ("site=north&from=a&to=1", 400, "from=a: give a whole number"),
            ("site=north&from=-1&to=1", 400, "not below 0"),
            ("site=north&from=0&to=1&window=60", 400, "\"window\": ask by"),
        ] {
            let Refusal(found, words) = refused(query);
            assert!(found == status && words.contains(said), "{query}: {found} {words}");
        }
    }

    #[test]
    fn a_name_that_is_not_there_has_no_answer() {
        assert!(answer("secrets", "", &morning(), Path::new("/")).is_none());
        let sites = answer("sites", "", &morning(), Path::new("/")).unwrap().unwrap();
        assert_eq!(
            (&sites[0]["site"], &sites[0]["density_veh_km"]),
            (&json!("north"), &Value::Null)
        );
    }
}
