//! `verge convert`: density messages in the formats of traffic centres.

use crate::daemon::clock;
use crate::daemon::exit::Failure;
use crate::daemon::output::WholeFile;
use crate::messages;
use crate::wire;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use verge_messages::Density;
use verge_messages::formats::{Exporter, Format, Publisher};
use verge_messages::objects::{Found, Inside, Objects, messages_in};

/// Longest line in hexadecimal that is read, bytes: many times the largest message.
const MAX_LINE: usize = 64 << 10;

/// The formats, with what each writes.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Target {
    /// FIWARE `TrafficFlowObserved`, NGSI-LD key values: one JSON array a message.
    Fiware,
    /// DATEX II v3 `MeasuredDataPublication`: one XML document.
    Datex2,
    /// DATEX II v3 `MeasurementSiteTablePublication`: where the sites are, one XML document.
    Datex2Sites,
    /// GeoJSON features, one a lane and window and line.
    Geojson,
    /// The values of NTCIP 1209: one JSON object a lane and window.
    Ntcip,
    /// One row a lane and window, RFC 4180.
    Csv,
    /// The daemon's own JSON: one object a message.
    Json,
}

impl From<Target> for Format {
    fn from(target: Target) -> Self {
        match target {
            Target::Fiware => Self::Fiware,
            Target::Datex2 => Self::Datex2,
            Target::Datex2Sites => Self::Datex2Sites,
            Target::Geojson => Self::Geojson,
            Target::Ntcip => Self::Ntcip,
            Target::Csv => Self::Csv,
            Target::Json => Self::Json,
        }
    }
}

/// How messages are encoded in the input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Form {
    /// JSON objects: one a line, with the topic in front (`mosquitto_sub -v`) or without, in
    /// arrays, pretty-printed, or in the `payload` of another object (`-F %j`).
    #[default]
    Json,
    /// Postcard in hexadecimal, one a line, as `mosquitto_sub -F %x` prints it.
    Postcard,
}

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The format to write
    #[arg(long, value_enum)]
    to: Target,
    /// How messages are encoded in the input
    #[arg(long, value_enum, default_value_t)]
    from: Form,
    /// The messages [default: standard input]
    #[arg(value_name = "FILE")]
    input: Option<PathBuf>,
    /// Write here, whole or not at all [default: standard output, as messages come]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// FIWARE: the road segment of the site, an URN
    #[arg(long, value_name = "URN", value_parser = urn)]
    road_segment: Option<String>,
    /// DATEX II: country of the publisher, two letters of ISO 3166-1
    #[arg(long, value_name = "CC", value_parser = country)]
    country: Option<String>,
}

fn country(text: &str) -> Result<String, String> {
    if text.len() == 2 && text.bytes().all(|byte| byte.is_ascii_alphabetic()) {
        Ok(text.to_owned())
    } else {
        Err("give the two letters of ISO 3166-1, such as DE".into())
    }
}

fn urn(text: &str) -> Result<String, String> {
    let plain = |byte: u8| byte.is_ascii_graphic() && !b"<>\"'=;()".contains(&byte);
    if text.contains(':') && text.bytes().all(plain) {
        Ok(text.to_owned())
    } else {
        Err("give an URN such as urn:ngsi-ld:RoadSegment:7".into())
    }
}

/// Converts every message that can be read. One that cannot is reported with its line, the
/// others are converted, and the program ends with 65.
pub fn run(args: &Args) -> Result<(), Failure> {
    let publisher =
        Publisher { road_segment: args.road_segment.clone(), country: args.country.clone() };
    let exporter = Exporter::new(args.to.into(), publisher);
    let (name, mut input) = open(args.input.as_deref())?;
    let mut output = Output::open(args.out.as_deref(), args.input.as_deref())?;
    exporter.begin(clock::now().into()).map_or(Ok(()), |head| output.line(&head))?;
    let broken = |source| Failure::Input { path: name.clone(), source };
    // A table of sites has each of them once, as its latest message has it.
    let mut sites = BTreeMap::new();
    let (mut count, mut bad, mut others) = (0, 0, 0);
    let mut convert = |line: usize, message: Result<Density, String>| {
        count += 1;
        let text = message.and_then(|message| Ok((exporter.message(&message)?, message)));
        match text {
            Ok((text, message)) if exporter.is_of_sites() => {
                sites.insert(message.site, text);
                Ok(())
            }
            Ok((text, _)) => output.line(&text),
            Err(reason) => {
                bad += 1;
                verge_desk::say(&format!("verge: {}: line {line}: {reason}", name.display()));
                Ok(())
            }
        }
    };
    match args.from {
        Form::Json => {
            let mut objects = Objects::of(input);
            while let Some(Found { line, object }) = objects.next_object().map_err(broken)? {
                match object.map(|object| messages_in(&object)) {
                    Ok(Inside::Messages(found)) => {
                        found.iter().try_for_each(|message| convert(line, of_json(message)))?;
                    }
                    Ok(Inside::Other) => others += 1,
                    Err(reason) => convert(line, Err(reason))?,
                }
            }
            others += objects.others();
        }
        Form::Postcard => {
            let (mut line, mut number) = (Vec::new(), 0);
            loop {
                number += 1;
                let message = match next_line(&mut input, &mut line).map_err(broken)? {
                    Line::End => break,
                    Line::Whole if line.trim_ascii().is_empty() => continue,
                    Line::Whole => of_postcard(&line),
                    Line::TooLong => Err(format!("a line of more than {MAX_LINE} bytes")),
                };
                convert(number, message)?;
            }
        }
    }
    sites.values().try_for_each(|site| output.line(site))?;
    exporter.end().map_or(Ok(()), |tail| output.line(&tail))?;
    output.finish()?;
    let name = name.display();
    if others > 0 {
        let kinds = "of other kinds (health, alarm, presence) left out";
        verge_desk::say(&format!("verge: {name}: {others} {kinds}"));
    }
    if count == 0 {
        verge_desk::say(&format!("verge: {name}: no density message in it"));
    }
    if bad > 0 { Err(Failure::Messages { bad, count }) } else { Ok(()) }
}

/// Reads one message and checks it.
fn of_json(message: &[u8]) -> Result<Density, String> {
    verge_messages::read(message).map_err(|error| {
        let is_python = message.starts_with(b"{'");
        let hint = "; its quotes are single, as Python shows a dict: print it with json.dumps";
        format!("{error}{}", if is_python { hint } else { "" })
    })
}

/// Reads one message from hexadecimal and checks it.
fn of_postcard(line: &[u8]) -> Result<Density, String> {
    let bytes = unhex(line)?;
    if bytes.starts_with(b"{") {
        // JSON in hexadecimal: the sensor publishes JSON, and `mosquitto_sub -F %x` showed it.
        return of_json(&bytes);
    }
    let message = wire::decode(&bytes).map_err(|error| error.to_string())?;
    let density = messages::density(&message, None);
    density.check().map_err(|wrong| wrong.to_string())?;
    Ok(density)
}

/// Bytes from hexadecimal, spaces around it passed over.
fn unhex(text: &[u8]) -> Result<Vec<u8>, String> {
    let text = text.trim_ascii();
    let digit = |at: usize| {
        let byte = text.get(at).copied().unwrap_or_default();
        char::from(byte).to_digit(16).map(|digit| digit as u8).ok_or_else(|| {
            let at = at + 1;
            format!("not hexadecimal at character {at}; print messages with `mosquitto_sub -F %x`")
        })
    };
    (0..text.len()).step_by(2).map(|at| Ok(digit(at)? << 4 | digit(at + 1)?)).collect()
}

fn open(path: Option<&Path>) -> Result<(PathBuf, Box<dyn BufRead>), Failure> {
    let (name, input): (PathBuf, Box<dyn BufRead>) = match path {
        None => ("standard input".into(), Box::new(io::stdin().lock())),
        Some(path) => {
            let unread = |source| Failure::Input { path: path.to_owned(), source };
            (path.to_owned(), Box::new(BufReader::new(File::open(path).map_err(unread)?)))
        }
    };
    let input = unpacked(input).map_err(|reason| match reason {
        Unpacked::Broken(source) => Failure::Input { path: name.clone(), source },
        Unpacked::Other(what) => Failure::InputForm { path: name.clone(), what },
    })?;
    Ok((name, input))
}

/// Why an input cannot be read as text.
enum Unpacked {
    Broken(io::Error),
    /// It is this, and what to do.
    Other(&'static str),
}

/// The text of an input by how it begins: packed by gzip or plain.
fn unpacked(mut input: Box<dyn BufRead>) -> Result<Box<dyn BufRead>, Unpacked> {
    let head = input.fill_buf().map_err(Unpacked::Broken)?;
    let what = match head {
        [0x1f, 0x8b, ..] => {
            return Ok(Box::new(BufReader::new(flate2::bufread::MultiGzDecoder::new(input))));
        }
        [0x28, 0xb5, 0x2f, 0xfd, ..] => "packed by zstd: unpack it first (zstd -dc)",
        [b'B', b'Z', b'h', ..] => "packed by bzip2: unpack it first (bzip2 -dc)",
        [0xfd, b'7', b'z', b'X', ..] => "packed by xz: unpack it first (xz -dc)",
        [b'P', b'K', 3, 4, ..] => "a ZIP file: unpack it first",
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [0, b'{' | b'[', ..] | [b'{' | b'[', 0, ..] => {
            "UTF-16, as PowerShell writes it: save it as UTF-8"
        }
        _ => return Ok(input),
    };
    Err(Unpacked::Other(what))
}

enum Line {
    Whole,
    TooLong,
    End,
}

/// Reads the next line into `line`; one that is too long is read over.
fn next_line(input: &mut dyn BufRead, line: &mut Vec<u8>) -> io::Result<Line> {
    line.clear();
    if input.take(MAX_LINE as u64 + 1).read_until(b'\n', line)? == 0 {
        return Ok(Line::End);
    }
    if line.len() <= MAX_LINE || line.ends_with(b"\n") {
        return Ok(Line::Whole);
    }
    input.skip_until(b'\n')?;
    Ok(Line::TooLong)
}

enum Output {
    Stream(io::Stdout),
    File(WholeFile),
}

impl Output {
    fn open(path: Option<&Path>, input: Option<&Path>) -> Result<Self, Failure> {
        Ok(match path {
            Some(path) => Self::File(WholeFile::beside(path, input.as_slice())?),
            None => Self::Stream(io::stdout()),
        })
    }

    /// Adds a line. A reader that has gone away (`| head`) ends the program in silence.
    fn line(&mut self, text: &str) -> Result<(), Failure> {
        match self {
            Self::File(file) => Ok(file.line(text)?),
            Self::Stream(stream) => match writeln!(stream, "{text}") {
                Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
                written => written.map_err(|source| Failure::Write {
                    path: Path::new("standard output").into(),
                    source,
                }),
            },
        }
    }

    fn finish(self) -> Result<(), Failure> {
        match self {
            Self::File(file) => Ok(file.finish()?),
            Self::Stream(_) => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn postcard_is_read_from_hexadecimal() {
        let read = |text: &str| of_postcard(text.as_bytes()).expect_err("no message");
        assert!(read("01zz").starts_with("not hexadecimal at character 3"));
        assert!(read("012").starts_with("not hexadecimal at character 4"));
        assert!(read("0500000000").starts_with("message format 5"));
    }

    #[test]
    fn a_line_that_is_too_long_is_read_over() {
        let long = "x".repeat(3 * MAX_LINE);
        let mut input = io::Cursor::new(format!("a\n{long}\nb"));
        let mut line = Vec::new();
        assert!(matches!(next_line(&mut input, &mut line), Ok(Line::Whole)));
        assert!(matches!(next_line(&mut input, &mut line), Ok(Line::TooLong)));
        assert!(matches!(next_line(&mut input, &mut line), Ok(Line::Whole)));
        assert_eq!(line, b"b");
        assert!(matches!(next_line(&mut input, &mut line), Ok(Line::End)));
    }
}
