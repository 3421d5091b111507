//! The line does not allocate per frame outside the picture decoder.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Duration;
use verge::daemon::capture::{Recorded, Source, decode};
use verge::daemon::counting::Counting;
use verge::daemon::detect::Detector;
use verge::daemon::detect::regions::{MAX_REGIONS, Parts};
use verge::daemon::frame::{Frame, Picture};
use verge::daemon::line::LineSettings;

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
fn detection_counting_and_windows_do_not_allocate() {
    let settings = LineSettings::recorded(
        common::STREET_TABLE.as_ref(),
        common::MODEL.as_ref(),
        Duration::from_secs(900),
    );
    let interval = Duration::from_secs(1);
    let recorded =
        Recorded::open(common::STREET_FRAMES.as_ref(), Some(interval)).expect("a recording");
    let mut source = Source::Recorded(recorded);
    let mut counting = Counting::open(&settings, interval).expect("a right table");
    let mut detector = Detector::load(&settings.model, None).expect("a right model");
    let input = detector.input_size();
    let parts = Parts::new(counting.table(), |point| counting.place(point), input);
    assert_eq!(parts.count(), MAX_REGIONS);
    let (mut frame, mut found) = (Frame::default(), Vec::with_capacity(64));
    for number in 0..7 {
        source.next(&mut frame).expect("a whole frame");
        let size = (frame.picture.width, frame.picture.height);
        let mut prepared = allocations(|| detector.look_at(&parts.of(size)));
        let mut rest = allocations(|| found.clear());
        for pass in 0..MAX_REGIONS {
            prepared += allocations(|| detector.prepare(&frame.picture, pass));
            let mut output = None;
            rest += allocations(|| output = Some(detector.infer().expect("inference")));
            let output = output.expect("it was computed");
            rest += allocations(|| {
                detector.read(&frame.picture, pass, &output, &mut found).expect("an output");
            });
        }
        rest += allocations(|| {
            counting.count(&found, size, frame.time).expect("the table's camera");
        });
        assert!(!found.is_empty());
        if number >= 2 {
            assert_eq!((prepared, rest), (0, 0), "frame {number}");
        }
    }
}
