//! `verge-detector check`: what verge makes of a model file.
//!
//! Owns the report and the sidecar to start from. The file is loaded and run as the box would;
//! nothing is known of its weights but their numbers.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use verge::daemon::detect::{HeadKind, Inspection, inspect};
use verge_desk::{Batch, Failure};

/// Nodes left to tract that are named one by one.
const NAMED: usize = 10;

/// Classes of the data set that most published detectors have learned.
const COCO_CLASSES: usize = 80;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Model file
    #[arg(value_name = "MODEL.onnx")]
    model: PathBuf,
    /// Input size in place of the file's, px
    #[arg(long, value_name = "WxH", value_parser = size)]
    input: Option<[usize; 2]>,
    /// Where the sidecar goes that is to start from [default: beside the model, unless there is one]
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let (width, height) = text.split_once('x').ok_or("width and height, as in 640x480")?;
    let side = |text: &str| text.parse::<usize>().map_err(|error| error.to_string());
    Ok([side(width)?, side(height)?])
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] where the model cannot be read or run, or the sidecar cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let model = &arguments.model;
    let inspection = inspect(model, arguments.input).map_err(|error| Failure::Content {
        path: model.clone(),
        line: 0,
        reason: error.to_string(),
    })?;
    print!("{}", report(&inspection));
    let beside = model.with_extension("toml");
    let out = arguments.out.clone().or_else(|| (!beside.exists()).then_some(beside));
    let Some(out) = out else {
        println!("sidecar     there is one beside the model; --out writes another");
        return Ok(());
    };
    // A sidecar names its model from where it lies itself.
    let file = match model.file_name() {
        Some(name) if out.parent() == model.parent() => PathBuf::from(name),
        _ => std::path::absolute(model).unwrap_or(model.clone()),
    };
    let mut batch = Batch::default();
    batch.add(&out, sidecar(&file, &inspection).as_bytes())?;
    batch.commit()?;
    println!("sidecar     {}: fill in what is marked", out.display());
    Ok(())
}

fn report(inspection: &Inspection) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<11} {value}");
    };
    let [width, height] = inspection.input_px;
    line("input", format!("{width}x{height} px"));
    line("outputs", format!("{:?}", inspection.outputs));
    line(
        "head",
        match &inspection.head {
            Some(head) if head.kind == HeadKind::Yolox => format!(
                "yolox with {} classes, by its shape; yolox_decoded if the graph gives pixels",
                head.classes
            ),
            Some(head) => {
                format!("{} with {} classes, by its shape", head.kind.name(), head.classes)
            }
            None => "none that verge knows has such outputs".to_owned(),
        },
    );
    line("runs on", inspection.runs_on.clone());
    line("one run", format!("{:.1} ms on this machine", inspection.took.as_secs_f64() * 1e3));
    for share in &inspection.shares {
        let percent = share.of_time * 100.0;
        line("", format!("{percent:5.1} % {} ({} nodes)", share.by, share.nodes));
    }
    for (operator, node, why) in inspection.left.iter().take(NAMED) {
        line("in tract", format!("{operator} {node}: {why}"));
    }
    if inspection.left.len() > NAMED {
        line("", format!("and {} more", inspection.left.len() - NAMED));
    }
    text
}

/// A sidecar with what the file tells, and marks where it does not.
fn sidecar(file: &Path, inspection: &Inspection) -> String {
    let name = file.file_stem().unwrap_or_default().to_string_lossy();
    let file = file.to_string_lossy();
    let [width, height] = inspection.input_px;
    let head = match &inspection.head {
        Some(head) => format!("head = \"{}\" # guessed from the shape\n", head.kind.name()),
        None => "# head = \"...\" # TO FILL IN: the head's name\n".to_owned(),
    };
    // Of other numbers of classes than COCO's, the first is a guess that loads.
    let classes = match &inspection.head {
        Some(head) if head.kind != HeadKind::End2end && head.classes != COCO_CLASSES => {
            "# TO FILL IN: the score columns that are vehicles\n[[class]]\nindex = 0\nname = \"car\"\n"
        }
        _ => {
            "# TO FILL IN: the score columns that are vehicles (COCO's are given)\n\
             [[class]]\nindex = 2\nname = \"car\"\n\n[[class]]\nindex = 5\nname = \"bus\"\n\n\
             [[class]]\nindex = 7\nname = \"truck\"\n"
        }
    };
    // An export that suppresses by itself needs no more of it.
    let iou = match &inspection.head {
        Some(head) if head.kind == HeadKind::End2end => "1.0",
        _ => "0.6",
    };
    format!(
        "name = {name:?}\nfile = {file:?}\nsha256 = \"{}\"\nlicence = \"\" # TO FILL IN\n{head}\n\
         [input]\nwidth_px = {width}\nheight_px = {height}\n\
         # TO FILL IN: as the model was trained\nchannels = \"rgb\"\nmean = [0.0, 0.0, 0.0]\n\
         std = [255.0, 255.0, 255.0]\n\n\
         {classes}\n\
         [thresholds]\nscore = 0.3\niou = {iou}\n",
        inspection.sha256
    )
}
