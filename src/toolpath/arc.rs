//! From the words of G2 and G3 to an arc, or the reason why there is none.

use std::f64::consts::TAU;

use super::path::{Arc, Plane};

/// Start and end of an arc may lie this much nearer to or farther from its centre than each other without a word. Units: mm.
pub(super) const RADIUS_DIFFERENCE_REPORTED: f64 = 0.02;

/// A difference of more than this part of the radius (and reported) is no rounding: the words describe no arc.
const RADIUS_DIFFERENCE_REFUSED: f64 = 0.1;

/// Start and end nearer to each other than this are one point, so the arc is a full circle. Units: mm.
const SAME_POINT: f64 = 1e-6;

/// How the program says where the centre is.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Centre {
    /// I, J or K: on the two axes of the plane, in mm.
    At([f64; 2]),
    /// R: the radius in mm, negative for the longer of the two arcs.
    Radius(f64),
}

/// The arc from `start` to `end`, both on the two axes of `plane`, with `turns` full turns added.
///
/// # Errors
/// A sentence with the values at fault.
pub(super) fn arc(
    plane: Plane,
    [start, end]: [[f64; 2]; 2],
    centre: Centre,
    counterclockwise: bool,
    turns: f64,
) -> Result<Arc, String> {
    let chord = [end[0] - start[0], end[1] - start[1]];
    let chord_length = chord[0].hypot(chord[1]);
    let closed = chord_length < SAME_POINT;
    let centre = match centre {
        Centre::At(centre) => centre,
        Centre::Radius(_) if closed => {
            return Err(
                "an arc given by R must end elsewhere than it starts; a full circle needs I, J or K"
                    .into(),
            );
        }
        Centre::Radius(radius) => {
            let half = chord_length / 2.0;
            let missing = half - radius.abs();
            if missing > RADIUS_DIFFERENCE_REPORTED || missing > RADIUS_DIFFERENCE_REFUSED * half {
                return Err(format!(
                    "radius R of {:.4} mm is too small: start and end are {chord_length:.4} mm apart, so it must be at least {half:.4} mm",
                    radius.abs()
                ));
            }
            // Rounded words may miss a half circle by a little: then its centre is the middle of the chord.
            let aside = (radius * radius - half * half).max(0.0).sqrt();
            // The shorter counterclockwise arc has its centre on the left of the chord.
            let left = if counterclockwise == (radius > 0.0) {
                aside / chord_length
            } else {
                -aside / chord_length
            };
            [
                f64::midpoint(start[0], end[0]) - chord[1] * left,
                f64::midpoint(start[1], end[1]) + chord[0] * left,
            ]
        }
    };
    let from = [start[0] - centre[0], start[1] - centre[1]];
    let to = [end[0] - centre[0], end[1] - centre[1]];
    let radius = [from[0].hypot(from[1]), to[0].hypot(to[1])];
    let difference = (radius[0] - radius[1]).abs();
    if radius[0] < SAME_POINT {
        return Err("the centre of the arc is its start, so it has no radius".into());
    }
    if difference > RADIUS_DIFFERENCE_REPORTED
        && difference > RADIUS_DIFFERENCE_REFUSED * radius[0].max(radius[1])
    {
        return Err(format!(
            "no such arc: its start is {:.4} mm and its end {:.4} mm from its centre",
            radius[0], radius[1]
        ));
    }
    let angle = from[1].atan2(from[0]);
    let once = if closed {
        if counterclockwise { TAU } else { -TAU }
    } else {
        sweep(angle, to[1].atan2(to[0]), counterclockwise)
    };
    Ok(Arc {
        plane,
        centre,
        radius,
        angle,
        sweep: once + (TAU * turns).copysign(once),
    })
}

/// The angle from `from` to `to` in the direction of `counterclockwise`: more than 0, at most one turn, with the sign of the
/// direction. Units: radians.
fn sweep(from: f64, to: f64, counterclockwise: bool) -> f64 {
    let turned = if counterclockwise {
        to - from
    } else {
        from - to
    };
    let around = turned.rem_euclid(TAU);
    let around = if around == 0.0 { TAU } else { around };
    if counterclockwise { around } else { -around }
}
