//! `verge-tmc points`: the archive's windows and detector data as points of density and speed.
//!
//! Owns the command, the points and what is left out; each source has its file. Density is
//! derived as k = q / v where a source has none.

mod archive;
mod hk;
mod hk_raw;
mod ngsim;
mod pems;

use crate::fit::{DENSITY, SPEED};
use std::fmt::Write;
use std::path::PathBuf;
use verge_desk::{Failure, make_parent, print, write_whole};

/// Speeds above this, km/h, are faults of a detector: none of the roads allows 110.
const MOST_KMH: f64 = 130.0;

/// Where points come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Source {
    /// A folder with one matrix *Density_Data.txt (veh/ft, all lanes) and one
    /// *Velocity_Data.txt (ft/s), made of NGSIM trajectories; needs --lanes.
    Ngsim,
    /// Hong Kong's detectors by the hour: CSV with detector, lane, mean_speed_kmh, volume_veh.
    Hk,
    /// Hong Kong's raw feed of 30 s: XML.
    HkRaw,
    /// PeMS station files of 5 minutes: CSV without a header, speeds in mph.
    Pems,
    /// The archive: a site's densities with its own speeds, or with those of --detector-csv.
    Archive,
}

/// Arguments of `points`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Kind of the input.
    #[arg(long)]
    from: Source,
    /// The file, or folder for ngsim; a gzipped file is unpacked.
    #[arg(long, value_name = "PATH")]
    input: PathBuf,
    /// Number of lanes that the matrices of ngsim sum over.
    #[arg(long, value_name = "N")]
    lanes: Option<u32>,
    /// Only this detector (PeMS: station).
    #[arg(long, value_name = "ID")]
    detector: Option<String>,
    /// Only this lane, named as in the input ("Fast Lane"; PeMS: its number).
    #[arg(long, value_name = "NAME")]
    lane: Option<String>,
    /// The site of the archive.
    #[arg(long, value_name = "NAME")]
    site: Option<String>,
    /// Length of the archive's windows, s; without it the shortest.
    #[arg(long, value_name = "S")]
    window: Option<i32>,
    /// A detector beside the site: CSV with time, speed_kmh or flow_veh_h, and site and lane where it
    /// is of several.
    #[arg(long, value_name = "FILE.csv")]
    detector_csv: Option<PathBuf>,
    /// Where the points go; without it to standard output.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// One reading of one lane, or of the mean lane.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Density k, veh/km/lane.
    pub density: f64,
    /// Speed v, km/h.
    pub speed: f64,
    /// Detector or station; empty where there is none.
    pub detector: String,
    /// Lane; empty where readings are means of all lanes.
    pub lane: String,
}

/// Readings, and how many were left out for which reason.
#[derive(Debug, Default)]
pub struct Readings {
    kept: Vec<Reading>,
    /// No vehicle passed: there is no speed.
    empty: usize,
    /// Speed 0 or above what vehicles drive.
    implausible: usize,
    /// The source says that it is not valid, or has no value.
    invalid: usize,
}

impl Readings {
    /// Takes density (veh/km/lane) and speed (km/h).
    fn add(&mut self, detector: &str, lane: &str, density: f64, speed: f64) {
        if density <= 0.0 {
            self.empty += 1;
        } else if speed <= 0.0 || speed > MOST_KMH {
            self.implausible += 1;
        } else {
            let (detector, lane) = (detector.to_owned(), lane.to_owned());
            self.kept.push(Reading { density, speed, detector, lane });
        }
    }

    /// Takes flow (veh/h/lane) and speed (km/h); density is k = q / v.
    fn add_flow(&mut self, detector: &str, lane: &str, flow: f64, speed: f64) {
        if flow <= 0.0 {
            self.empty += 1;
        } else if speed <= 0.0 || speed > MOST_KMH {
            self.implausible += 1;
        } else {
            let (detector, lane) = (detector.to_owned(), lane.to_owned());
            self.kept.push(Reading { density: flow / speed, speed, detector, lane });
        }
    }
}

/// Runs `points`.
///
/// # Errors
/// [`Failure`]: wrong input, or an output that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let of_archive =
        arguments.site.is_some() || arguments.detector_csv.is_some() || arguments.window.is_some();
    if of_archive && arguments.from != Source::Archive {
        let hint = "--site, --window and --detector-csv go with --from archive only";
        return Err(Failure::Usage(hint.into()));
    }
    let readings = match (arguments.from, arguments.lanes) {
        (Source::Ngsim, None | Some(0)) => {
            let hint = "ngsim's matrices sum over all lanes: give their number with --lanes \
                        (I-80: 6, US-101: 5)";
            return Err(Failure::Usage(hint.into()));
        }
        (Source::Ngsim, Some(lanes)) => ngsim::read(&arguments.input, lanes)?,
        (_, Some(_)) => {
            return Err(Failure::Usage("--lanes goes with --from ngsim only".into()));
        }
        (Source::Hk, None) => hk::read(&arguments.input)?,
        (Source::HkRaw, None) => hk_raw::read(&arguments.input)?,
        (Source::Pems, None) => pems::read(&arguments.input)?,
        (Source::Archive, None) => {
            let Some(site) = &arguments.site else {
                let hint = "the archive has many sites: give one with --site";
                return Err(Failure::Usage(hint.into()));
            };
            archive::read(&archive::Question {
                archive: &arguments.input,
                site,
                window_s: arguments.window,
                detector: arguments.detector_csv.as_deref(),
            })?
        }
    };
    let is = |wanted: &Option<String>, found: &str| wanted.as_ref().is_none_or(|w| w == found);
    let mut text = format!("{DENSITY},{SPEED},detector,lane\n");
    let mut chosen = 0;
    for Reading { density, speed, detector, lane } in &readings.kept {
        if is(&arguments.detector, detector) && is(&arguments.lane, lane) {
            chosen += 1;
            // Writing to a string does not fail.
            let _ = writeln!(text, "{density:.6},{speed:.6},{detector},{lane}");
        }
    }
    if chosen == 0 {
        let reason = "gives no points; are --detector and --lane named as in the input?";
        return Err(Failure::content(&arguments.input, 0, reason));
    }
    match &arguments.out {
        Some(path) => {
            make_parent(path)?;
            write_whole(path, text.as_bytes())?;
        }
        None => print(&text)?,
    }
    let Readings { kept, empty, implausible, invalid } = readings;
    eprintln!(
        "verge-tmc: {chosen} points of {} usable readings; left out: {empty} without vehicles, \
         {implausible} with speed 0 or above {MOST_KMH} km/h, {invalid} invalid",
        kept.len()
    );
    Ok(())
}
