//! The command line: what can be asked, and who does it.

use super::commands;
use super::config::DEFAULT_MODEL;
use super::exit::Failure;
use super::locate::Anchor;
use crate::hal::{Board, Switch, Thermometer, Watchdog};
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

/// A traffic camera as a calibrated sensor of density, lane by lane.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Measure as configured and publish until stopped
    Run {
        /// Configuration, TOML
        #[arg(long, value_name = "FILE")]
        config: PathBuf,
    },
    /// Try every part of a configuration, one line per check
    Check {
        /// Configuration, TOML
        #[arg(long, value_name = "FILE")]
        config: PathBuf,
    },
    /// Measure density in recorded frames
    Replay(Replay),
    /// Find vehicles in recorded frames, without a lane table
    Detect(Detect),
    /// Time every stage; prints JSON
    Bench(Bench),
    /// Play a recording through the whole line to an MQTT client, all in this process
    #[cfg(feature = "demo")]
    Demo,
}

/// Which model to use.
#[derive(Debug, Args)]
pub(super) struct ModelArgs {
    /// Model (.onnx) or its sidecar (.toml)
    #[arg(long, value_name = "FILE", default_value = DEFAULT_MODEL)]
    pub(super) model: PathBuf,
    /// Least score that counts, 0 to 1 [default: the sidecar's]
    #[arg(long, value_name = "SCORE")]
    pub(super) score: Option<f32>,
}

/// `verge replay`
#[derive(Debug, Args)]
pub(super) struct Replay {
    /// Lane table
    #[arg(long, value_name = "FILE")]
    pub(super) table: PathBuf,
    /// Folder of JPEG or PNG frames, played in the order of their names
    #[arg(long, value_name = "DIR")]
    pub(super) frames: PathBuf,
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// One JSON object per window instead of one line per lane
    #[arg(long)]
    pub(super) json: bool,
    /// Window length, s
    #[arg(long, value_name = "S", default_value_t = 900)]
    pub(super) window: u64,
    /// Time between frames, s [default: from names, file times, else 120]
    #[arg(long, value_name = "S")]
    pub(super) interval: Option<f64>,
    /// Also write each frame's boxes here, JSON Lines
    #[arg(long, value_name = "FILE")]
    pub(super) detections: Option<PathBuf>,
    /// Which point of a box stands for the vehicle
    #[arg(long, value_enum, default_value_t)]
    pub(super) anchor: Anchor,
}

/// `verge detect`
#[derive(Debug, Args)]
pub(super) struct Detect {
    /// Folder of JPEG or PNG frames
    #[arg(long, value_name = "DIR")]
    pub(super) frames: PathBuf,
    /// Where each frame's boxes are written, JSON Lines
    #[arg(long, value_name = "FILE")]
    pub(super) detections: PathBuf,
    #[command(flatten)]
    pub(super) model: ModelArgs,
}

/// `verge bench`
#[derive(Debug, Args)]
pub(super) struct Bench {
    /// Folder of JPEG or PNG frames [default: the demo's recording]
    #[arg(long, value_name = "DIR", requires = "table")]
    pub(super) frames: Option<PathBuf>,
    /// Lane table of these frames
    #[arg(long, value_name = "FILE")]
    pub(super) table: Option<PathBuf>,
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// Frames to measure, after as many again to warm up
    #[arg(long, value_name = "N", default_value_t = 50)]
    pub(super) count: usize,
}

/// Reads the command line and does what it says.
pub(super) fn run<L, R, W, T>(board: Board<L, R, W, T>) -> Result<(), Failure>
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
    let cli = Cli::try_parse().unwrap_or_else(|error| {
        let _ = error.print();
        // sysexits: 64 is a wrong command line; help and version are none.
        std::process::exit(if error.use_stderr() { 64 } else { 0 });
    });
    let level = if matches!(cli.command, Command::Run { .. }) {
        log::LevelFilter::Info
    } else {
        log::LevelFilter::Warn
    };
    env_logger::Builder::new()
        .filter_level(level)
        // The embedded broker reports each packet as an error.
        .filter_module("rumqttd", log::LevelFilter::Off)
        .parse_default_env()
        .init();
    match cli.command {
        Command::Run { config } => commands::run::run(&config, board),
        Command::Check { config } => commands::check::run(&config),
        Command::Replay(args) => commands::replay::run(&args),
        Command::Detect(args) => commands::detect::run(&args),
        Command::Bench(args) => commands::bench::run(&args),
        #[cfg(feature = "demo")]
        Command::Demo => commands::demo::run(),
    }
}
