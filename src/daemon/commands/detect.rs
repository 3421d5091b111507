//! `verge detect`: boxes of recorded frames, without a lane table.
//!
//! What a lane table would tell comes from the frames themselves, which are of one camera: a first
//! look at some of them gives the size of cars by place, the input of the net that it asks for, and
//! what the road looks like without vehicles.

use super::playback::search;
use super::{ModelArgs, text};
use crate::daemon::assemble::{Recorded, open_detector};
use crate::daemon::config::NetInput;
use crate::daemon::detect::{Detector, LoadOptions};
use crate::daemon::exit::Failure;
use crate::daemon::frame::{Detection, Picture};
use crate::daemon::output::WholeFile;
use crate::daemon::scene::Scene;
use crate::daemon::vehicles::{Sample, Vehicles};
use crate::evidence::CarSize;
use crate::units::UtcMs;
use std::path::PathBuf;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of JPEG or PNG frames
    #[arg(long, value_name = "DIR")]
    frames: PathBuf,
    /// Where each frame's boxes are written, JSON Lines
    #[arg(long, value_name = "FILE")]
    detections: PathBuf,
    #[command(flatten)]
    model: ModelArgs,
}

/// Frames of the first look, spread over the recording.
const FIRST_LOOK: usize = 48;
/// Time between two frames for the empty road's memory: as far apart as it asks for at least.
const APART_MS: i64 = 60_000;

pub fn run(args: &Args) -> Result<(), Failure> {
    let ModelArgs { model, score, input } = &args.model;
    let described = Detector::described(model)?;
    let options = LoadOptions { score: *score, candidates: true, ..LoadOptions::default() };
    let mut looking = Looking::new(Vehicles::new(described.evidence, *score, [0; 2]));
    let (recorded, mut detector) = open_detector(&args.frames, model, &options)?;
    let own = detector.input_size();
    if described.evidence.is_some() {
        looking.vehicles = Vehicles::new(described.evidence, *score, own);
        let (mut sample, mut number) = (Sample::default(), 0);
        let stride = recorded.frames().div_ceil(FIRST_LOOK).max(1);
        let look = |picture: &Picture, found: &mut Vec<Detection>| {
            number += 1;
            found.clear();
            if (number - 1) % stride == 0 {
                detector.detect(picture, found)?;
                sample.add((picture.width, picture.height), found);
                looking.choose(picture, found);
            }
            Ok(())
        };
        search(recorded, look, |_, _| Ok(()))?;
        looking.size = sample.size();
        if looking.size.is_none() {
            log::warn!(
                "the size of cars is not used: too few are seen, or the frames are of several cameras"
            );
        }
        let input_px = match input {
            NetInput::Px(size) => *size,
            NetInput::Auto => described.input_for(sample.car_px(own)),
        };
        looking.vehicles = Vehicles::new(described.evidence, *score, input_px);
        let options = LoadOptions { input_px: Some(input_px), ..options };
        let (recorded, detector) = open_detector(&args.frames, model, &options)?;
        return write(recorded, detector, looking, args);
    }
    if let NetInput::Px(size) = input {
        let options = LoadOptions { input_px: Some(*size), ..options };
        let (recorded, detector) = open_detector(&args.frames, model, &options)?;
        return write(recorded, detector, looking, args);
    }
    write(recorded, detector, looking, args)
}

fn write(
    recorded: Recorded,
    mut detector: Detector,
    mut looking: Looking,
    args: &Args,
) -> Result<(), Failure> {
    let mut file = WholeFile::create(&args.detections)?;
    search(
        recorded,
        |picture, found| {
            detector.detect(picture, found)?;
            looking.choose(picture, found);
            Ok(())
        },
        |frame, found| file.line(&text::boxes(frame, found)),
    )?;
    file.finish()
}

/// What is known of a camera from its frames.
struct Looking {
    vehicles: Vehicles,
    size: Option<CarSize>,
    scene: Scene,
    frames: i64,
}

impl Looking {
    fn new(vehicles: Vehicles) -> Self {
        Self { vehicles, size: None, scene: Scene::new(Vec::new()), frames: 0 }
    }

    /// Leaves the vehicles in what was found, and learns the road.
    fn choose(&mut self, picture: &Picture, found: &mut Vec<Detection>) {
        self.scene.judge(picture, UtcMs(self.frames * APART_MS));
        self.frames += 1;
        let Self { scene, size, .. } = self;
        let picture = (picture.width, picture.height);
        self.vehicles.choose(found, picture, *size, |bounds| scene.likeness(bounds));
        scene.learn(0, found);
    }
}
