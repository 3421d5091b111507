//! `verge detect`: boxes of recorded frames, without a lane table.

use super::text;
use crate::daemon::cli;
use crate::daemon::exit::Failure;
use crate::daemon::open_detector;
use crate::daemon::output::WholeFile;
use crate::daemon::playback::search;

pub fn run(args: &cli::Detect) -> Result<(), Failure> {
    let (recorded, mut detector) =
        open_detector(&args.frames, &args.model.model, args.model.score)?;
    let mut file = WholeFile::create(&args.detections)?;
    search(recorded, &mut detector, |frame, found| file.line(&text::boxes(frame, found)))?;
    file.finish()
}
