//! The command line: what can be asked, and who does it.

use super::commands;
use super::exit::Failure;
use super::manual;
use crate::hal::{Board, Switch, Thermometer, Watchdog};
use clap::{CommandFactory, Parser, Subcommand};
use std::path::PathBuf;

/// A traffic camera as a calibrated sensor of density, lane by lane.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true)]
pub(super) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Measure as configured and publish until stopped
    ///
    /// SIGTERM and SIGINT stop it. SIGHUP makes it read configuration, lane tables and model
    /// again; they take over when the running windows end, and where something is wrong with
    /// them the old ones stay in force.
    Run {
        /// Configuration, TOML
        #[arg(long, value_name = "FILE")]
        config: PathBuf,
    },
    /// Try every part of a configuration, one line per check
    ///
    /// As root it tries the unit's configuration (/etc/verge/verge.toml) as the unit's user.
    Check {
        /// Configuration, TOML
        #[arg(long, value_name = "FILE")]
        config: PathBuf,
        /// Try for up to five minutes until all passes: for a new system that is to be kept or
        /// given up
        #[arg(long)]
        after_update: bool,
        /// Also draw the present picture with lanes, boxes, contact points and counts
        #[arg(long, value_name = "FILE.png", value_parser = png)]
        overlay: Option<PathBuf>,
        /// For whoever turns the camera: print each second how far it is off and which way to turn
        /// it, until it stands in place; nothing else is tried
        #[arg(long, conflicts_with_all = ["after_update", "overlay"])]
        aim: bool,
    },
    /// Show what the sensor sees on a page of this machine, which changes nothing
    ///
    /// The page is answered on loopback alone, under an address with a token; from elsewhere it is
    /// reached by `ssh -L`. The camera is asked once more beside `verge run`, while the page is open.
    View {
        /// Configuration, TOML
        #[arg(long, value_name = "FILE")]
        config: PathBuf,
        /// Port on loopback; a free one by default
        #[arg(long, default_value_t = 0)]
        port: u16,
    },
    /// Measure density in recorded frames
    Replay(commands::replay::Args),
    /// Count a site by eye: choose frames, draw them, and learn from the answers
    Audit(commands::audit::Args),
    /// Collect pictures of a camera into a folder, over minutes or hours
    Collect(commands::collect::Args),
    /// Find vehicles in recorded frames, without a lane table
    Detect(commands::detect::Args),
    /// Rewrite published messages for a traffic centre: FIWARE, DATEX II, NTCIP, CSV
    #[cfg(feature = "desk")]
    Convert(commands::convert::Args),
    /// Set up an I/O node on a serial line, or read its counters
    Node(commands::node::Args),
    /// Time every stage; prints JSON
    Bench(commands::bench::Args),
    /// Write the manual pages into a folder, for packages
    #[command(hide = true)]
    Man {
        /// The folder
        folder: PathBuf,
    },
    /// Play a recording through the whole line to an MQTT client, all in this process
    #[cfg(feature = "demo")]
    Demo,
}

/// Reads the name of a PNG.
fn png(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_other = |suffix: &std::ffi::OsStr| !suffix.eq_ignore_ascii_case("png");
    if path.extension().is_some_and(is_other) {
        return Err("it is written as PNG: give a name that ends in .png".to_owned());
    }
    Ok(path)
}

/// Does what the command line says.
pub(super) fn run<L, R, W, T>(cli: Cli, board: Board<L, R, W, T>) -> Result<(), Failure>
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
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
        Command::Check { config, aim: true, .. } => commands::check::aim::run(&config),
        Command::Check { config, after_update, overlay, .. } => {
            commands::check::run(&config, after_update, overlay.as_deref())
        }
        Command::View { config, port } => commands::view::run(&config, port),
        Command::Replay(args) => commands::replay::run(&args),
        Command::Audit(args) => commands::audit::run(&args),
        Command::Collect(args) => commands::collect::run(&args),
        Command::Detect(args) => commands::detect::run(&args),
        #[cfg(feature = "desk")]
        Command::Convert(args) => commands::convert::run(&args),
        Command::Node(args) => commands::node::run(&args),
        Command::Bench(args) => commands::bench::run(&args),
        Command::Man { folder } => manual::write(Cli::command(), &folder),
        #[cfg(feature = "demo")]
        Command::Demo => commands::demo::run(),
    }
}
