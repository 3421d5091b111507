//! The map of all sites as SVG: web Mercator, north up, a length to compare.
//!
//! A plain one unless the operator names a source of tiles: then its pictures lie below, and the
//! browser fetches them. A site is a circle in the colour and with the letter of its level; one with
//! trouble is a square with `!`. A stroke points where its traffic goes.

use super::SiteNow;
use super::page::escaped;
use std::f64::consts::PI;
use std::fmt::Write;
use verge_desk::Failure;

const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 420.0;
const MARGIN: f64 = 46.0;
/// Pixels of a tile.
const TILE: f64 = 256.0;
/// Deepest zoom: a tile of some 150 m.
const DEEPEST: f64 = 18.0;
/// Earth's circumference at the equator, m.
const CIRCUMFERENCE_M: f64 = 40_075_016.7;

/// Where a tile server has its tiles: `https://host/{z}/{x}/{y}.png`, and who is to be named.
#[derive(Clone, Debug)]
pub struct Tiles {
    /// The address with `{z}`, `{x}` and `{y}`.
    pub template: String,
    /// Owner of the map.
    pub attribution: String,
}

impl Tiles {
    /// As given on the command line.
    ///
    /// # Errors
    /// [`Failure`] where the address has not its three parts.
    pub fn of(template: Option<&str>, by: Option<&str>) -> Result<Option<Self>, Failure> {
        let Some(template) = template else { return Ok(None) };
        let is_right = ["{z}", "{x}", "{y}"].iter().all(|part| template.contains(part))
            && ["https://", "http://", "/"].iter().any(|begin| template.starts_with(begin));
        if !is_right {
            let how = "give https://HOST/{z}/{x}/{y}.png";
            return Err(Failure::Usage(format!("--tiles {template:?}: {how}")));
        }
        let attribution = by.unwrap_or_default().to_owned();
        Ok(Some(Self { template: template.to_owned(), attribution }))
    }
}

/// Web Mercator: the whole world from 0 to 1, y downwards.
fn mercator([latitude, longitude]: [f64; 2]) -> [f64; 2] {
    // Beyond this the projection has no end.
    let latitude = latitude.clamp(-85.05, 85.05).to_radians();
    let y = ((PI / 4.0 + latitude / 2.0).tan()).ln();
    [(longitude + 180.0) / 360.0, (1.0 - y / PI) / 2.0]
}

/// From the world to the drawing.
struct View {
    /// Pixels that the world is wide.
    world_px: f64,
    zoom: u32,
    /// The world's point at the drawing's left upper corner, px.
    corner: [f64; 2],
}

impl View {
    /// In which all these points lie.
    fn of(points: &[[f64; 2]], whole: bool) -> Self {
        let low = |axis: usize| points.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
        let high = |axis: usize| points.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
        let room = [WIDTH - 2.0 * MARGIN, HEIGHT - 2.0 * MARGIN];
        let fit = |axis: usize| room[axis] / (high(axis) - low(axis)).max(1e-12);
        let zoom = (fit(0).min(fit(1)) / TILE).log2().clamp(0.0, DEEPEST - 1.0);
        // Tiles come at whole zooms.
        let zoom = if whole { zoom.floor() } else { zoom };
        let world_px = TILE * zoom.exp2();
        let corner = [0, 1].map(|axis| {
            let half = [WIDTH, HEIGHT][axis] / 2.0;
            f64::midpoint(low(axis), high(axis)) * world_px - half
        });
        Self { world_px, zoom: zoom as u32, corner }
    }

    fn at(&self, point: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| point[axis] * self.world_px - self.corner[axis])
    }
}

/// The map; empty where no site says where it is.
pub(super) fn map(sites: &[SiteNow], tiles: Option<&Tiles>) -> String {
    let placed: Vec<(&SiteNow, [f64; 2], [f64; 2])> = sites
        .iter()
        .filter_map(|site| {
            let position = site.known.place.position()?;
            Some((site, position, mercator(position)))
        })
        .collect();
    if placed.is_empty() {
        return String::new();
    }
    let points: Vec<_> = placed.iter().map(|(_, _, point)| *point).collect();
    let view = View::of(&points, tiles.is_some());
    let mut svg = format!(
        "<svg class=\"map\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"group\" \
         aria-label=\"Map of {} sites\">",
        placed.len()
    );
    svg.push_str(&match tiles {
        Some(tiles) => pictures(&view, tiles),
        None => graticule(&view),
    });
    // Trouble is drawn last and lies on top.
    for (site, _, point) in placed.iter().rev() {
        svg.push_str(&marker(site, view.at(*point)));
    }
    let middle =
        placed.iter().map(|(_, [latitude, _], _)| latitude).sum::<f64>() / placed.len() as f64;
    svg.push_str(&scale(&view, middle));
    let _ = write!(
        svg,
        "<g class=\"north\" aria-hidden=\"true\"><path d=\"M{0},14 l6,16 -6,-4 -6,4 z\"/>\
         <text x=\"{0}\" y=\"44\" text-anchor=\"middle\">N</text></g>",
        WIDTH - 24.0
    );
    if let Some(tiles) = tiles {
        let _ = write!(
            svg,
            "<text class=\"halo\" x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
            WIDTH - 8.0,
            HEIGHT - 8.0,
            escaped(&tiles.attribution)
        );
    }
    svg.push_str("</svg>\n");
    svg
}

fn marker(site: &SiteNow, [x, y]: [f64; 2]) -> String {
    let name = escaped(&site.site);
    let level = site.level().map(|(_, letter)| letter);
    let what = match (site.trouble.first(), level) {
        (Some(trouble), _) => trouble.reason.clone(),
        (None, Some(letter)) => format!("level {letter}"),
        (None, None) => "no density".into(),
    };
    let title = format!("{}: {what}", site.known.place.name.as_deref().unwrap_or(&site.site));
    let mut shape = String::new();
    if let Some(bearing) = site.known.place.bearing {
        let (sin, cos) = bearing.to_radians().sin_cos();
        let _ = write!(
            shape,
            "<line class=\"heading\" x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\"/>",
            x + 9.0 * sin,
            y - 9.0 * cos,
            x + 19.0 * sin,
            y - 19.0 * cos
        );
    }
    let (class, letter) = match (site.trouble.is_empty(), level) {
        (false, _) => ("trouble".to_owned(), '!'),
        (true, Some(letter)) => (format!("level-{letter}"), letter),
        (true, None) => ("unknown".to_owned(), '?'),
    };
    if site.trouble.is_empty() {
        let _ = write!(shape, "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"10\"/>");
    } else {
        let _ = write!(
            shape,
            "<rect class=\"{class}\" x=\"{:.1}\" y=\"{:.1}\" width=\"20\" height=\"20\" rx=\"3\"/>",
            x - 10.0,
            y - 10.0
        );
    }
    format!(
        "<a href=\"sites/{name}/index.html\"><title>{}</title>{shape}\
         <text class=\"on-{class}\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{letter}</text></a>",
        escaped(&title),
        y + 4.5
    )
}

/// Meridians and parallels at round degrees.
fn graticule(view: &View) -> String {
    let mut lines = String::new();
    let longitude = |x: f64| (x + view.corner[0]) / view.world_px * 360.0 - 180.0;
    let latitude = |y: f64| {
        let n = PI * (1.0 - 2.0 * (y + view.corner[1]) / view.world_px);
        n.sinh().atan().to_degrees()
    };
    let ticks = |ends: [f64; 2]| crate::chart::axes::round_ticks(ends);
    for (degrees, text) in ticks([longitude(0.0), longitude(WIDTH)]) {
        let [x, _] = view.at(mercator([0.0, degrees]));
        let _ = write!(
            lines,
            "<line class=\"grid\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"0\" y2=\"{HEIGHT}\"/>\
             <text x=\"{:.1}\" y=\"{}\">{text}\u{b0}</text>",
            x + 4.0,
            HEIGHT - 8.0
        );
    }
    for (degrees, text) in ticks([latitude(HEIGHT), latitude(0.0)]) {
        let [_, y] = view.at(mercator([degrees, 0.0]));
        let _ = write!(
            lines,
            "<line class=\"grid\" x1=\"0\" x2=\"{WIDTH}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>\
             <text x=\"6\" y=\"{:.1}\">{text}\u{b0}</text>",
            y - 4.0
        );
    }
    lines
}

fn pictures(view: &View, tiles: &Tiles) -> String {
    let mut images = String::new();
    let count = 1i64 << view.zoom;
    let first = view.corner.map(|at| (at / TILE).floor() as i64);
    let last = [
        ((view.corner[0] + WIDTH) / TILE).floor() as i64,
        ((view.corner[1] + HEIGHT) / TILE).floor() as i64,
    ];
    for x in first[0]..=last[0] {
        for y in first[1]..=last[1] {
            if !(0..count).contains(&y) {
                continue;
            }
            let address = tiles
                .template
                .replace("{z}", &view.zoom.to_string())
                .replace("{x}", &x.rem_euclid(count).to_string())
                .replace("{y}", &y.to_string());
            let _ = write!(
                images,
                "<image href=\"{}\" x=\"{:.1}\" y=\"{:.1}\" width=\"256\" height=\"256\"/>",
                escaped(&address),
                x as f64 * TILE - view.corner[0],
                y as f64 * TILE - view.corner[1]
            );
        }
    }
    images
}

/// A length of 1, 2 or 5 times a power of ten, some 120 px long.
fn scale(view: &View, latitude: f64) -> String {
    let metres_per_px = CIRCUMFERENCE_M * latitude.to_radians().cos() / view.world_px;
    let rough = 120.0 * metres_per_px;
    let power = 10f64.powf(rough.log10().floor());
    let metres = [5.0, 2.0, 1.0].map(|n| n * power).into_iter().find(|m| *m <= rough);
    let metres = metres.unwrap_or(power);
    let text =
        if metres >= 1000.0 { format!("{} km", metres / 1000.0) } else { format!("{metres} m") };
    let (left, right, y) = (56.0, 56.0 + metres / metres_per_px, HEIGHT - 26.0);
    format!(
        "<g class=\"scale\"><path d=\"M{left},{y} v6 H{right:.1} v-6\"/>\
         <text class=\"halo\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{text}</text></g>",
        f64::midpoint(left, right),
        y - 2.0
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_projection_is_that_of_tile_servers() {
        // OpenStreetMap's wiki: the tile of a place is floor(2^z * this).
        let [x, y] = mercator([22.3193, 114.1694]).map(|it| it * 1024.0);
        assert_eq!((x.floor(), y.floor()), (836.0, 446.0));
        assert_eq!(mercator([0.0, 0.0]), [0.5, 0.5]);
    }

    #[test]
    fn a_source_of_tiles_has_three_parts() {
        assert!(Tiles::of(None, None).unwrap().is_none());
        assert!(Tiles::of(Some("https://tiles.example/{z}/{x}/{y}.png"), Some("us")).is_ok());
        for wrong in ["https://tiles.example/{z}/{x}.png", "javascript:{z}{x}{y}"] {
            assert!(Tiles::of(Some(wrong), None).is_err(), "{wrong}");
        }
    }

    #[test]
    fn all_points_lie_inside_the_margin() {
        let points = [[22.28, 114.1], [22.45, 114.3], [22.3, 114.0]].map(mercator);
        for whole in [false, true] {
            let view = View::of(&points, whole);
            for point in points {
                let [x, y] = view.at(point);
                assert!((MARGIN - 1e-6..=WIDTH - MARGIN + 1e-6).contains(&x), "{x}");
                assert!((MARGIN - 1e-6..=HEIGHT - MARGIN + 1e-6).contains(&y), "{y}");
            }
        }
        let one = View::of(&points[..1], false);
        assert_eq!(one.at(points[0]).map(f64::round), [WIDTH / 2.0, HEIGHT / 2.0]);
    }
}
