//! The strokes of a canned cycle at one hole.

use super::codes::Cycle;

/// How far a chip-breaking cycle lifts, and how far above the depth reached a peck goes down fast. Units: mm.
///
/// # Source
/// `LinuxCNC`, which takes 0.010 inch; Fanuc and Haas have a parameter for it.
const LIFT: f64 = 0.254;

/// Steps into which a hole may be cut.
const STEPS_MAX: f64 = 100_000.0;

/// Depths along the normal of the plane. Units: mm.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Depths {
    /// Where rapids end.
    pub(super) r: f64,
    pub(super) bottom: f64,
    /// Where the tool is left.
    pub(super) clear: f64,
    /// Longest step of cycles that have some.
    pub(super) step: Option<f64>,
    /// At the bottom. Units: seconds.
    pub(super) dwell: Option<f64>,
}

/// What a cycle does over its hole.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Stroke {
    Rapid(f64),
    Feed(f64),
    Dwell(f64),
}

/// The strokes from R on.
///
/// # Errors
/// A sentence when the depths make no hole.
pub(super) fn strokes(cycle: Cycle, depths: Depths) -> Result<Vec<Stroke>, String> {
    let Depths {
        r,
        bottom,
        clear,
        step,
        dwell,
    } = depths;
    if bottom > r {
        return Err(format!(
            "the bottom of the hole ({bottom:.4} mm) is above R ({r:.4} mm)"
        ));
    }
    let mut strokes = Vec::new();
    if let (Cycle::Peck | Cycle::ChipBreak, Some(step)) = (cycle, step) {
        if (r - bottom) / step > STEPS_MAX {
            return Err(format!("a hole of more than {STEPS_MAX} steps"));
        }
        let mut depth = r - step;
        while depth > bottom {
            strokes.push(Stroke::Feed(depth));
            if cycle == Cycle::Peck {
                strokes.push(Stroke::Rapid(r));
            }
            strokes.push(Stroke::Rapid(depth + LIFT));
            depth -= step;
        }
    }
    strokes.push(Stroke::Feed(bottom));
    strokes.extend(dwell.map(Stroke::Dwell));
    match cycle {
        Cycle::Drill | Cycle::DrillDwell | Cycle::Peck | Cycle::ChipBreak | Cycle::BoreStop => {}
        Cycle::Bore | Cycle::Tap => strokes.push(Stroke::Feed(r)),
        Cycle::BoreDwell => strokes.push(Stroke::Feed(clear)),
    }
    strokes.push(Stroke::Rapid(clear));
    Ok(strokes)
}
