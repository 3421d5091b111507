//! The line does not allocate per frame outside the picture decoder.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Duration;
use verge::daemon::capture::{Recorded, Source, decode};
use verge::daemon::config::Views;
use verge::daemon::detect::regions::MAX_REGIONS;
use verge::daemon::frame::{Frame, Picture};
use verge::daemon::line::{Line, LineSettings};
use verge::daemon::presets::WindowSettings;
use verge::sensor::{Now, Outcome, Sensor};

/// The system's allocator, counting what this thread asks of it.
struct Counted;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed on unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps `alloc`'s contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps `dealloc`'s contract.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps `realloc`'s contract.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counted = Counted;

fn allocations(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.with(Cell::get);
    work();
    ALLOCATIONS.with(Cell::get) - before
}

#[test]
fn capture_allocates_what_the_decoder_does() {
    let folder = common::folder();
    let bytes = common::jpeg(320, 240, 90);
    for second in 0..6 {
        let path = folder.path().join(format!("20260105T08000{second}Z.jpg"));
        std::fs::write(path, &bytes).expect("writing a frame");
    }
    let mut source = Source::Recorded(Recorded::open(folder.path(), None).expect("a recording"));
    let (mut frame, mut picture) = (Frame::default(), Picture::default());
    for number in 0..6 {
        let captured = allocations(|| {
            source.next(&mut frame).expect("a whole frame");
        });
        let decoded = allocations(|| decode(&bytes, &mut picture).expect("a whole picture"));
        // The first frames bring the buffers to their size.
        if number >= 2 {
            assert_eq!(captured, decoded, "frame {number}");
        }
    }
}

#[test]
fn the_line_and_the_sensor_do_not_allocate() {
    let interval = Duration::from_secs(1);
    let settings = LineSettings {
        views: Views::Auto,
        ..LineSettings::recorded(common::STREET_TABLE.as_ref(), common::MODEL.as_ref())
    };
    let recorded =
        Recorded::open(common::STREET_FRAMES.as_ref(), Some(interval)).expect("a recording");
    let mut source = Source::Recorded(recorded);
    let mut line = Line::open(&settings).expect("a right model and table");
    assert_eq!(line.parts().count(), MAX_REGIONS);
    let windows = WindowSettings::recorded(Duration::from_secs(900));
    let presets = line.windows(&windows, interval).expect("right windows");
    let mut sensor = Sensor::new(presets, interval);
    let (mut frame, mut stages) = (Frame::default(), Vec::with_capacity(64));
    for number in 0..7 {
        source.next(&mut frame).expect("a whole frame");
        let now = Now { time: frame.time, since_start: interval * number, synchronised: true };
        stages.clear();
        let mut before = ALLOCATIONS.with(Cell::get);
        let mut observe = |stage| {
            let now = ALLOCATIONS.with(Cell::get);
            stages.push((stage, now - std::mem::replace(&mut before, now)));
        };
        let outcome = line.measure(&frame, &mut observe).expect("a frame of the table's camera");
        assert!(matches!(outcome, Outcome::Measured { .. }), "{outcome:?}");
        let decided = allocations(|| {
            sensor.turn(now, frame.time, &outcome, &mut |_| ()).expect("no fault");
            sensor.tick(now, false, &mut |_| ());
        });
        assert!(!line.found().is_empty());
        assert_eq!(stages.len(), 1 + 3 * MAX_REGIONS + 1, "{stages:?}");
        // The first frames bring the buffers to their size.
        if number >= 2 {
            let allocated = stages.iter().filter(|(_, count)| *count > 0).collect::<Vec<_>>();
            assert!(allocated.is_empty() && decided == 0, "frame {number}: {allocated:?}");
        }
    }
}
