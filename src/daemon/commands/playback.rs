//! A recording from its first frame to its last, through a line or a detector.
//!
//! Owns what happens to frames that cannot be used: they are logged, counted as missed, and
//! only a recording of which nothing could be used is an error.

use crate::daemon::capture::{Captured, Recorded, Source};
use crate::daemon::exit::Failure;
use crate::daemon::frame::{Detection, Frame, Picture};
use crate::daemon::line::Line;
use crate::sensor::{ClosedWindow, Outcome, Preset, Windows};

/// One step of a recording as it is played.
pub enum Played<'a> {
    /// A frame that went through the line, which knows what was found in it, and what became of
    /// it where it was not counted.
    Frame(&'a Frame, &'a Line, Option<&'static str>),
    /// A window that has closed.
    Window(ClosedWindow<'a>),
}

/// Plays a recording through a line: each frame that was measured, and the windows as
/// they close. Frames that cannot be measured are logged and count as missed.
pub fn play(
    recorded: Recorded,
    line: &mut Line,
    mut windows: Windows<Vec<Preset>>,
    mut on: impl FnMut(Played<'_>) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut player = Player::new(recorded);
    while let Some(captured) = player.next() {
        let (time, mut written) = (player.frame.time, Ok(()));
        let mut closed = |window: ClosedWindow<'_>| {
            if written.is_ok() {
                written = on(Played::Window(window));
            }
        };
        match captured.and_then(|()| line.measure(&player.frame, &mut |_| ())) {
            Ok(outcome) => {
                let withheld = player.judged(&outcome);
                windows.take(time, &outcome, &mut closed);
                written?;
                on(Played::Frame(&player.frame, line, withheld))?;
            }
            Err(fault) => {
                player.note(&fault);
                windows.take(time, &Outcome::Damaged, &mut closed);
                written?;
            }
        }
    }
    player.finish()?;
    let mut written = Ok(());
    windows.finish(&mut |window| {
        if written.is_ok() {
            written = on(Played::Window(window));
        }
    });
    written
}

/// Searches a recording for vehicles. Frames that cannot be searched are logged.
pub fn search(
    recorded: Recorded,
    mut detect: impl FnMut(&Picture, &mut Vec<Detection>) -> Result<(), Failure>,
    mut on_frame: impl FnMut(&Frame, &[Detection]) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut player = Player::new(recorded);
    let mut found = Vec::new();
    while let Some(captured) = player.next() {
        match captured.and_then(|()| detect(&player.frame.picture, &mut found)) {
            Ok(()) => {
                player.measured += 1;
                on_frame(&player.frame, &found)?;
            }
            Err(fault) => player.note(&fault),
        }
    }
    player.finish()
}

/// Shows each frame of a recording. Frames that cannot be used are logged; a wrong answer of a
/// person ends it.
pub fn walk(
    recorded: Recorded,
    mut on_frame: impl FnMut(&Frame) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut player = Player::new(recorded);
    while let Some(captured) = player.next() {
        match captured.and_then(|()| on_frame(&player.frame)) {
            Ok(()) => player.measured += 1,
            Err(fault @ (Failure::Answers(_) | Failure::Write { .. })) => {
                return Err(fault);
            }
            Err(fault) => player.note(&fault),
        }
    }
    player.finish()
}

/// A recording as it is played, and how that goes.
struct Player {
    source: Source,
    frame: Frame,
    frames: usize,
    measured: usize,
    first_fault: Option<String>,
    /// The fault logged last, and how many more frames had it.
    repeated: Option<(String, usize)>,
    /// The words logged last about the frames.
    said: Option<&'static str>,
}

impl Player {
    fn new(recorded: Recorded) -> Self {
        let frames = recorded.frames();
        let source = Source::Recorded(recorded);
        Self {
            source,
            frame: Frame::default(),
            frames,
            measured: 0,
            first_fault: None,
            repeated: None,
            said: None,
        }
    }

    /// Fills `frame` with the next picture; `None` at the end.
    fn next(&mut self) -> Option<Result<(), Failure>> {
        match self.source.next(&mut self.frame) {
            Ok(Captured::End) => None,
            Ok(Captured::New | Captured::Unchanged) => Some(Ok(())),
            Err(fault) => Some(Err(fault.into())),
        }
    }

    /// Says what a frame was when that changes; returns why it was not counted.
    fn judged(&mut self, outcome: &Outcome<'_>) -> Option<&'static str> {
        self.measured += 1;
        let is = match outcome {
            Outcome::Withheld(alarm) => Some(alarm.name()),
            Outcome::Unchanged => Some("shows nothing new"),
            Outcome::PassedOver => Some("is displaced"),
            _ => None,
        };
        if is == self.said {
            return is;
        }
        self.said = is;
        let name = &self.frame.name;
        match (is, outcome) {
            (Some(alarm), Outcome::Withheld(_)) => log::warn!("from frame {name} on: {alarm}"),
            (Some(is), _) => log::warn!("frame {name} {is}"),
            (None, _) => log::info!("from frame {name} on all is well"),
        }
        is
    }

    fn note(&mut self, fault: &Failure) {
        let what = fault.of_any_picture();
        match &mut self.repeated {
            Some((said, more)) if *said == what => *more += 1,
            _ => {
                self.tell_repeated();
                log::warn!("frame {} is left out: {what}", self.frame.name);
                self.repeated = Some((what, 0));
            }
        }
        self.first_fault.get_or_insert_with(|| fault.to_string());
    }

    /// Says how many frames had the fault that was logged last, and forgets it.
    fn tell_repeated(&mut self) {
        if let Some((what, more @ 1..)) = self.repeated.take() {
            log::warn!("{more} more frames are left out: {what}");
        }
    }

    /// A recording of which nothing could be measured is an error.
    fn finish(mut self) -> Result<(), Failure> {
        self.tell_repeated();
        match self.first_fault {
            Some(first) if self.measured == 0 => {
                Err(Failure::NothingMeasured { frames: self.frames, first })
            }
            _ => Ok(()),
        }
    }
}
