//! Level of service by density: Highway Capacity Manual, 6th edition (TRB, 2016), Exhibit 12-15,
//! basic freeway segments.
//!
//! The manual's densities are passenger cars a mile and lane; verge counts vehicles and does not
//! turn lorries into cars, so that a road with many of them is somewhat worse than its letter.

/// A kilometre has so many miles.
const MILES: f32 = 0.621_371_2;
/// Upper ends of A to E, passenger cars a mile and lane.
const ENDS: [f32; 5] = [11.0, 18.0, 26.0, 35.0, 45.0];
/// The letters.
const LETTERS: [char; 6] = ['A', 'B', 'C', 'D', 'E', 'F'];

/// The level of a density in veh/km/lane.
pub fn level(density_veh_km: f32) -> char {
    let per_mile = density_veh_km / MILES;
    let index = ENDS.iter().position(|end| per_mile <= *end).unwrap_or(ENDS.len());
    LETTERS[index]
}

/// A level in words, for those who do not know the letters.
pub const fn words(level: char) -> &'static str {
    match level {
        'A' => "free",
        'B' => "reasonably free",
        'C' => "near free",
        'D' => "dense",
        'E' => "at capacity",
        _ => "broken down",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_change_at_the_manuals_densities() {
        // 11, 18, 26, 35 and 45 pc/mi/ln in veh/km.
        for (end, below, above) in [
            (6.835, 'A', 'B'),
            (11.184, 'B', 'C'),
            (16.155, 'C', 'D'),
            (21.747, 'D', 'E'),
            (27.961, 'E', 'F'),
        ] {
            assert_eq!((level(end - 0.01), level(end + 0.01)), (below, above), "{end}");
        }
        assert_eq!(level(0.0), 'A');
    }
}
