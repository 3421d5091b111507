//! Messages of windows that were really counted, for tests of what reads messages.

use std::time::Duration;
use verge::daemon::publish::Identity;
use verge::density::{Aggregator, SampleZoneStatus, Start};
use verge::lane::{LaneTable, Name};
use verge::sensor::ClosedWindow;
use verge::units::{LaneId, UtcMs, VehicleClass};
use verge::wire::{CalibrationRef, DensityMessage, ModelRef};

const MINUTE: Duration = Duration::from_secs(60);

/// A minute with vehicles, and one without a picture, which has this status.
pub fn messages(table: Vec<u8>, site: &str, status: SampleZoneStatus) -> Vec<DensityMessage> {
    let table = LaneTable::parse(table).expect("a right table");
    let (lanes, cell_m) = (&table.description().lanes, table.description().cell_length_m);
    let mut line: Aggregator =
        Aggregator::new(lanes, cell_m, &[MINUTE], MINUTE / 3, 0.5, Start::AtNextWindow)
            .expect("right");
    let mut counts = line.counts();
    counts.add(LaneId::new(2).expect("in range"), 12.0, VehicleClass::Bus);
    let mut closed = Vec::new();
    for second in [0, 20, 40, 60] {
        closed.extend(line.observe(UtcMs(1_767_600_000_000 + second * 1000), &counts));
    }
    closed.extend(line.miss(UtcMs(1_767_600_120_000), status));
    assert_eq!(closed.len(), 2);
    let model = ModelRef { name: Name::try_from("test").expect("short"), sha256: [7; 32] };
    let identity = Identity::new(site, &model);
    let calibration = &CalibrationRef::of(table.description());
    let message = |report, seq| identity.message(ClosedWindow { report, calibration }, true, seq);
    (1..).zip(&closed).map(|(seq, report)| message(report, seq)).collect()
}
