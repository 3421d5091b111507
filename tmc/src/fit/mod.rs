//! `verge-tmc fit`: a fundamental diagram from points of density and speed.
//!
//! Owns the command and the file of points; `model` has the relations, `estimate` fits,
//! `least_squares` and `interval` are its means, `report` prints, `plot` draws.

pub mod estimate;
mod interval;
mod least_squares;
pub mod model;
mod plot;
mod report;

pub use estimate::{Estimate, Fit, fit};
pub use least_squares::Point;
pub use model::Model;

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
    /// Which relation between density and speed.
    #[arg(long)]
    model: Model,
    /// Points: CSV with the columns density_veh_km and speed_kmh.
    #[arg(long, value_name = "FILE")]
    points: PathBuf,
    /// Resist outliers: an M-estimate instead of least squares.
    #[arg(long)]
    robust: bool,
    /// One JSON object instead of the table.
    #[arg(long)]
    json: bool,
    /// Speed and flow over density with points, fit and its 95 % band, as PNG.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// Runs `fit`.
///
/// # Errors
/// [`Failure`]: the points cannot be read or do not allow the fit, the plot not be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let points = read_points(&arguments.points)?;
    let fit = fit(arguments.model, &points, arguments.robust)
        .map_err(|reason| Failure::content(&arguments.points, 0, reason))?;
    if let Some(path) = &arguments.plot {
        make_parent(path)?;
        write_whole(path, &plot::drawing(&fit, &points).png())?;
    }
    for warning in &fit.warnings {
        eprintln!("verge-tmc: note: {warning}");
    }
    print(&if arguments.json { report::json(&fit) } else { report::table(&fit) })
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
