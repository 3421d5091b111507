//! Order of recorded frames: how far they are apart, and which of them belong to one instant.
//!
//! Owns the arithmetic of their times alone; `recorded` has the files.

use crate::units::UtcMs;
use std::time::Duration;

/// Names tell whole seconds: two frames of one second are of one instant where frames are at least this
/// far apart. A stream's may be several in each second.
const APART: Duration = Duration::from_secs(2);

/// Whether frames that both have this time are of one instant, in a recording with this time between
/// two: whole seconds may be all that their names tell.
pub(super) fn is_one_instant(time: UtcMs, step: Duration) -> bool {
    time.0 % 1000 != 0 || step >= APART
}

/// The median time from one frame to the next.
pub(super) fn median_step(times: &[Option<UtcMs>]) -> Option<Duration> {
    let mut times: Vec<_> = times.iter().flatten().copied().collect();
    times.sort();
    let mut steps: Vec<_> =
        times.windows(2).map(|pair| pair[1].saturating_since(pair[0])).collect();
    steps.sort();
    // Frames of one second: as many as there are share it.
    let span = times.last()?.saturating_since(*times.first()?);
    let median = *steps.get(steps.len() / 2)?;
    let mean = span.checked_div(u32::try_from(steps.len()).ok()?)?;
    Some(if median.is_zero() { mean } else { median }).filter(|step| !step.is_zero())
}

/// Leaves the longest row of rising times and takes the others out: files copied later, or back.
pub(super) fn keep_rising(times: &mut [Option<UtcMs>]) {
    // Patience sorting: the last file of the best row of each length, and what stands before it.
    let (mut ends, mut before): (Vec<usize>, Vec<Option<usize>>) =
        (Vec::new(), vec![None; times.len()]);
    for index in 0..times.len() {
        let Some(time) = times[index] else { continue };
        let length = ends.partition_point(|&end| times[end] < Some(time));
        before[index] = length.checked_sub(1).map(|shorter| ends[shorter]);
        if length == ends.len() { ends.push(index) } else { ends[length] = index }
    }
    let mut kept = vec![false; times.len()];
    let mut at = ends.last().copied();
    while let Some(index) = at {
        kept[index] = true;
        at = before[index];
    }
    times.iter_mut().zip(kept).filter(|(_, kept)| !kept).for_each(|(time, _)| *time = None);
}

/// Frames of one second, whose names tell no more, are spread over the time to the next one. They are
/// in their order.
pub(super) fn spread(mut times: Vec<&mut UtcMs>) {
    let mut from = 0;
    while from < times.len() {
        let time = *times[from];
        let same = times[from..].iter().take_while(|other| ***other == time).count();
        let next = times.get(from + same).map(|next| next.saturating_since(time));
        let room = next.unwrap_or(Duration::from_secs(1)).min(Duration::from_secs(1));
        for (place, other) in times[from..from + same].iter_mut().enumerate().skip(1) {
            **other = time.saturating_add(room.mul_f64(place as f64 / same as f64));
        }
        from += same;
    }
}
