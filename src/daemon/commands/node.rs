//! `verge node`: an I/O node's settings and counters over its serial line.

use super::print;
use crate::daemon::exit::Failure;
use crate::daemon::foreign::shown;
use crate::daemon::plain;
use crate::daemon::serial::{DEFAULT_BAUD, SerialLine};
use crate::daemon::toml_file;
use crate::lane::{MAX_NAME, Name};
use crate::node::protocol::{read_answer, write_request};
use crate::node::{Answer, MAX_OUTPUTS, Output, Request, Settings};
use crate::units::LaneId;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest wait for an answer: 256 bytes take 0.3 s at 9,600 baud.
const ANSWER_LIMIT: Duration = Duration::from_secs(2);

/// Most bytes of a file of settings.
const MAX_SETTINGS: u64 = 1 << 20;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The serial line to which the node is connected
    #[arg(long, value_name = "PATH")]
    device: PathBuf,
    /// Bits per second
    #[arg(long, value_name = "N", default_value_t = DEFAULT_BAUD)]
    baud: u32,
    #[command(subcommand)]
    question: Question,
}

#[derive(Debug, clap::Subcommand)]
enum Question {
    /// Print the settings that the node works by, in the form that `set` reads
    Settings,
    /// Send settings; the node checks them, keeps them and works by them
    Set {
        /// Settings, TOML
        file: PathBuf,
    },
    /// Print what the node has counted since its start
    Counters,
}

/// The settings as a file has them.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    site: String,
    #[serde(default)]
    window_s: u16,
    hold_s: u16,
    #[serde(default, rename = "output")]
    outputs: Vec<FileOutput>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileOutput {
    number: u8,
    lane: u8,
    on_veh_km: f32,
    off_veh_km: f32,
    #[serde(default)]
    least_on_s: u16,
    fail_safe: Contact,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Contact {
    Open,
    Closed,
}

/// Asks the node and prints its answer.
pub fn run(args: &Args) -> Result<(), Failure> {
    let request = match &args.question {
        Question::Settings => Request::Settings,
        Question::Set { file } => Request::Set(read(file)?),
        Question::Counters => Request::Counters,
    };
    let failed = |source| Failure::Serial { device: args.device.clone(), source };
    let mut line = SerialLine::open(&args.device, args.baud).map_err(failed)?;
    let mut buffer = [0; 512];
    let content = write_request(&request, &mut buffer).expect("512 bytes hold every request");
    line.send(content).map_err(failed)?;
    let answer = line.receive(ANSWER_LIMIT, |frame| read_answer(frame).ok()).map_err(failed)?;
    let text = match answer {
        Answer::Settings { sequence, settings } => {
            format!("# written {sequence} times\n{}", toml_of(&written(&settings)))
        }
        Answer::Counters(counters) => toml_of(&counters),
        Answer::Refused(reason) => {
            return Err(Failure::NodeSettings { path: None, reason: reason.to_string() });
        }
        Answer::NotKept => {
            let reason = "the node's flash did not take them and the old ones stay; try again, \
                          then replace the node";
            return Err(Failure::NodeSettings { path: None, reason: reason.into() });
        }
    };
    print(text.trim_end())
}

fn toml_of(value: &impl Serialize) -> String {
    toml::to_string(value).expect("numbers, names and tables of them are TOML")
}

fn read(path: &Path) -> Result<Settings, Failure> {
    let text = plain::read_text(path, MAX_SETTINGS)
        .map_err(|source| Failure::Input { path: path.to_owned(), source })?;
    parse(&text).map_err(|reason| Failure::NodeSettings { path: Some(path.to_owned()), reason })
}

fn parse(text: &str) -> Result<Settings, String> {
    let file: File = toml_file::parse(text, &[]).map_err(|fault| fault.to_string())?;
    let site = Name::try_from(file.site.as_str()).map_err(|_| {
        let site = shown(&file.site);
        format!("site \"{site}\" is longer than a site's name can be, {MAX_NAME} bytes")
    })?;
    let mut settings =
        Settings { site, window_s: file.window_s, hold_s: file.hold_s, ..Settings::default() };
    for output in file.outputs {
        let number = output.number;
        let place = usize::from(number)
            .checked_sub(1)
            .and_then(|index| settings.outputs.get_mut(index))
            .ok_or(format!("output {number}: a node has outputs 1 to {MAX_OUTPUTS}"))?;
        let lane = LaneId::new(output.lane)
            .ok_or(format!("output {number}: lane {} is outside 1 to 8", output.lane))?;
        let set = Output {
            lane,
            on_veh_km: output.on_veh_km,
            off_veh_km: output.off_veh_km,
            least_on_s: output.least_on_s,
            fail_safe: matches!(output.fail_safe, Contact::Closed),
        };
        if place.replace(set).is_some() {
            return Err(format!("output {number} is set twice"));
        }
    }
    settings.check().map_err(|error| error.to_string())?;
    Ok(settings)
}

fn written(settings: &Settings) -> File {
    let outputs = (1..).zip(&settings.outputs).filter_map(|(number, output)| {
        let &Output { lane, on_veh_km, off_veh_km, least_on_s, fail_safe } = output.as_ref()?;
        let fail_safe = if fail_safe { Contact::Closed } else { Contact::Open };
        Some(FileOutput { number, lane: lane.get(), on_veh_km, off_veh_km, least_on_s, fail_safe })
    });
    File {
        site: settings.site.as_str().into(),
        window_s: settings.window_s,
        hold_s: settings.hold_s,
        outputs: outputs.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "site = \"k1\"\nwindow_s = 60\nhold_s = 150\n\n[[output]]\nnumber = 2\n\
                        lane = 1\non_veh_km = 40.0\noff_veh_km = 30.0\nleast_on_s = 20\n\
                        fail_safe = \"closed\"\n";

    #[test]
    fn what_is_printed_is_what_set_reads() {
        let settings = parse(FILE).expect("a good file");
        assert_eq!(toml_of(&written(&settings)), FILE);
    }

    #[test]
    fn a_wrong_file_names_the_output_and_what_is_possible() {
        for (from, to, expected) in [
            ("number = 2", "number = 9", "output 9: a node has outputs 1 to 8"),
            ("lane = 1", "lane = 0", "output 2: lane 0 is outside 1 to 8"),
            ("off_veh_km = 30.0", "off_veh_km = 50.0", "output 2: off_veh_km must be below"),
            ("hold_s = 150", "hold_s = 30", "hold_s must be"),
            ("lane = 1", "line = 1", "output.line is not known"),
        ] {
            let error = parse(&FILE.replace(from, to)).expect_err("a wrong file");
            assert!(error.contains(expected), "{error}");
        }
        let twice = format!("{FILE}{}", &FILE[FILE.find("\n[[").expect("a table")..]);
        assert_eq!(parse(&twice).expect_err("twice"), "output 2 is set twice");
    }
}
