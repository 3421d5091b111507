//! How each cue of a road fit fits, in words.
//!
//! Owns the lines that `mvcalib calibrate` prints. Does not own what is measured (see `road::fit`).

use mvcalib::length_error::LengthError;
use mvcalib::road::fit::Fit;
use std::fmt::Write;

/// How each cue of a road fit fits.
pub fn text(found: &Fit) -> String {
    let mut text = String::new();
    let mut line = |l: std::fmt::Arguments<'_>| {
        let _ = writeln!(text, "{l}");
    };
    for mark in &found.marks {
        let measured: Vec<String> = mark.measured_m.iter().map(|m| format!("{m:.2}")).collect();
        let (known, sd, measured) = (mark.known_m, mark.in_sd, measured.join(", "));
        line(format_args!("{}: {known:.2} m, measured {measured} m ({sd:.1} sd)", mark.name));
    }
    for lane in &found.lanes {
        let [near, mean, far] = lane.width_m;
        line(format_args!("{}: {near:.2} m wide near, {mean:.2} m, {far:.2} m far", lane.name));
    }
    for rectangle in &found.rectangles {
        let ([a, b], sd) = (rectangle.sides_m, rectangle.in_sd);
        let known =
            rectangle.known_m.map_or(String::new(), |[a, b]| format!(" {a:.2} x {b:.2} m,"));
        line(format_args!(
            "{}:{known} measured {a:.2} x {b:.2} m, {:.1} degrees ({sd:.1} sd)",
            rectangle.name, rectangle.angle_deg
        ));
    }
    if let Some(traffic) = &found.traffic {
        let [longer, sd] = traffic.car_length.map(|x| 100.0 * x);
        line(format_args!(
            "traffic: {} boxes; cars here would be {longer:+.1} % long against most fleets \
             (+- {sd:.1} %)",
            traffic.used
        ));
    }
    let errors = found.errors();
    for (name, place) in [("near", errors.near), ("middle", errors.middle), ("far", errors.far)] {
        let (along, across) = (place.along, place.across);
        line(format_args!(
            "{name} (v {:.0} px): {:.0} m along the road +- {:.1} % ({:.2} m), across +- {:.1} %",
            place.at[1],
            along.length_m,
            100.0 * along.rel_sd,
            along.rel_sd * along.length_m,
            100.0 * across.rel_sd,
        ));
    }
    for lane in &errors.lanes {
        let of = |(_, e): &([f64; 2], LengthError)| {
            format!("{:.1} % ({:.2} m)", 100.0 * e.rel_sd, e.rel_sd * e.length_m)
        };
        let [near, middle, far] = lane.places.each_ref().map(of);
        let name = &lane.name;
        line(format_args!("{name}: width +- {near} near, +- {middle}, +- {far} far"));
    }
    text
}
