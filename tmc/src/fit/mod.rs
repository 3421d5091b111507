//! `verge-tmc fit`: a fundamental diagram from points of density and speed.
//!
//! Owns the command and the file of points; `model` has the relations, `estimate` fits from `starts`,
//! `least_squares` and `interval` are its means, `report` prints, `plot` draws, in `hexagons` where
//! there are many points.

pub mod estimate;
mod hexagons;
mod interval;
mod least_squares;
pub mod model;
mod plot;
mod report;
mod starts;

pub use estimate::{Estimate, Fit, fit};
pub use least_squares::Point;
pub use model::Model;
pub use plot::Units;

use plot::Look;

use crate::csv::Table;
use std::path::{Path, PathBuf};
use verge_desk::{Failure, make_parent, print, write_whole};

/// Column of the density, veh/km/lane.
pub const DENSITY: &str = "density_veh_km";
/// Column of the space-mean speed, km/h.
pub const SPEED: &str = "speed_kmh";

/// Arguments of `fit`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// The relation between density and speed; without it all of them, compared by AICc, and the
    /// best in full.
    #[arg(long)]
    model: Option<Model>,
    /// Points: CSV with the columns density_veh_km and speed_kmh.
    #[arg(long, value_name = "FILE")]
    points: PathBuf,
    /// Resist outliers: an M-estimate instead of least squares.
    #[arg(long, requires = "model")]
    robust: bool,
    /// One JSON object instead of the table.
    #[arg(long)]
    json: bool,
    /// Speed and flow over density with points, fit and its 95 % band: FILE.svg, FILE.pdf or FILE.png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Title of the plot.
    #[arg(long, value_name = "TEXT", requires = "plot")]
    title: Option<String>,
    /// Units of the plot.
    #[arg(long, value_enum, default_value_t, requires = "plot")]
    units: Units,
}

/// Runs `fit`.
///
/// # Errors
/// [`Failure`]: the points cannot be read or do not allow the fit, the plot not be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let points = read_points(&arguments.points)?;
    let wrong = |reason| Failure::content(&arguments.points, 0, reason);
    let (fit, others) = match arguments.model {
        Some(model) => (fit(model, &points, arguments.robust).map_err(wrong)?, Vec::new()),
        None => best_of_all(&points, arguments.json).map_err(wrong)?,
    };
    if let Some(path) = &arguments.plot {
        make_parent(path)?;
        let look = Look { title: arguments.title.clone(), units: arguments.units };
        let drawing = plot::drawing(&fit, &points, &look);
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        let bytes = match ending {
            "svg" => drawing.svg().into_bytes(),
            "pdf" => drawing.pdf(),
            "png" => drawing.png(),
            _ => {
                return Err(Failure::Usage(format!(
                    "--plot {path:?}: end it in .svg, .pdf or .png"
                )));
            }
        };
        write_whole(path, &bytes)?;
    }
    for warning in &fit.warnings {
        eprintln!("verge-tmc: note: {warning}");
    }
    print(&if arguments.json { report::json(&fit, &others) } else { report::table(&fit) })
}

/// Fits every model; the best by AICc, and all that could be, the best first.
fn best_of_all(points: &[Point], is_json: bool) -> Result<(Fit, Vec<Fit>), String> {
    let (mut fits, mut refused) = (Vec::new(), Vec::new());
    for model in Model::ALL {
        match fit(model, points, false) {
            Ok(fit) => fits.push(fit),
            Err(reason) => refused.push((model, reason)),
        }
    }
    fits.sort_by(|a, b| a.aicc.total_cmp(&b.aicc));
    let Some(best) = fits.first().cloned() else {
        return Err(refused.into_iter().map(|(_, reason)| reason).next().unwrap_or_default());
    };
    if !is_json {
        // To a closed pipe nobody listens; the table behind it says so.
        let _ = print(&report::compared(&fits, &refused));
    }
    Ok((best, fits))
}

/// Reads density and speed from a CSV file.
///
/// # Errors
/// [`Failure`] with line and column of what is wrong.
pub fn read_points(path: &Path) -> Result<Vec<Point>, Failure> {
    let table = Table::read(path)?;
    let (density, speed) = (table.column(DENSITY)?, table.column(SPEED)?);
    let points: Vec<Point> = table
        .rows()
        .map(|row| {
            let row = row?;
            Ok((row.quantity(&density)?, row.quantity(&speed)?))
        })
        .collect::<Result<_, Failure>>()?;
    if points.is_empty() {
        return Err(Failure::content(path, 0, "has no points below its header"));
    }
    Ok(points)
}
