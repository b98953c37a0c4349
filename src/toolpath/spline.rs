//! Splines cut into chords.

/// The parts into which a curve may be cut.
const PARTS_MAX: u32 = 100_000;

/// The chords of a curve given for parameters from 0 to 1: their ends, the last exactly at 1. No chord is farther than `tolerance`
/// from the curve where it is looked at (in the middle and at both quarters), which for splines without cusps bounds it anywhere.
pub(super) fn chords(
    curve: impl Fn(f64) -> [f64; 2],
    pieces: u32,
    tolerance: f64,
) -> Vec<[f64; 2]> {
    let mut ends = Vec::new();
    for piece in 0..pieces {
        let part = |number: u32| f64::from(number) / f64::from(pieces);
        divide(
            &curve,
            [part(piece), part(piece + 1)],
            tolerance,
            PARTS_MAX,
            &mut ends,
        );
    }
    ends
}

fn divide(
    curve: &impl Fn(f64) -> [f64; 2],
    [from, to]: [f64; 2],
    tolerance: f64,
    parts: u32,
    ends: &mut Vec<[f64; 2]>,
) {
    let (start, end) = (curve(from), curve(to));
    let middle = f64::midpoint(from, to);
    let looked_at = [
        f64::midpoint(from, middle),
        middle,
        f64::midpoint(middle, to),
    ];
    let near = looked_at
        .iter()
        .all(|part| distance_to(curve(*part), start, end) <= tolerance);
    if near || parts <= 1 {
        ends.push(end);
    } else {
        divide(curve, [from, middle], tolerance, parts / 2, ends);
        divide(curve, [middle, to], tolerance, parts / 2, ends);
    }
}

fn distance_to(point: [f64; 2], start: [f64; 2], end: [f64; 2]) -> f64 {
    let along = [end[0] - start[0], end[1] - start[1]];
    let from = [point[0] - start[0], point[1] - start[1]];
    let length2 = along[0] * along[0] + along[1] * along[1];
    let part = if length2 > 0.0 {
        ((from[0] * along[0] + from[1] * along[1]) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (from[0] - along[0] * part).hypot(from[1] - along[1] * part)
}

/// A Bézier curve of any degree, by de Casteljau's scheme.
pub(super) fn bezier<const COUNT: usize>(points: [[f64; 2]; COUNT]) -> impl Fn(f64) -> [f64; 2] {
    move |part| {
        let mut left = points;
        for level in (1..COUNT).rev() {
            for index in 0..level {
                left[index] = [0, 1].map(|axis| {
                    left[index][axis] + (left[index + 1][axis] - left[index][axis]) * part
                });
            }
        }
        left[0]
    }
}

/// A control point of a NURBS.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Control {
    pub(super) at: [f64; 2],
    pub(super) weight: f64,
}

/// A NURBS of some order through its first and last control points, its inner knots evenly spaced.
///
/// # Source
/// De Boor's scheme on the control points with their weights as third coordinate (Piegl and Tiller, The NURBS Book, 4.1).
pub(super) fn nurbs(controls: &[Control], order: usize) -> impl Fn(f64) -> [f64; 2] {
    assert!(order >= 2 && controls.len() >= order, "checked when read");
    let degree = order - 1;
    let spans = controls.len() - degree;
    let knot = move |index: usize| {
        f64::from(u32::try_from(index.saturating_sub(degree).min(spans)).expect("few"))
    };
    let points: Vec<[f64; 3]> = controls
        .iter()
        .map(|control| {
            [
                control.at[0] * control.weight,
                control.at[1] * control.weight,
                control.weight,
            ]
        })
        .collect();
    move |part| {
        let at = part * knot(degree + spans);
        let span = (degree..degree + spans)
            .rev()
            .find(|index| knot(*index) <= at)
            .unwrap_or(degree);
        let mut near: Vec<[f64; 3]> = points[span - degree..=span].to_vec();
        for level in 1..=degree {
            for index in (level..=degree).rev() {
                let (low, high) = (knot(span - degree + index), knot(span + 1 + index - level));
                let share = (at - low) / (high - low);
                near[index] = [0, 1, 2].map(|axis| {
                    near[index - 1][axis] + (near[index][axis] - near[index - 1][axis]) * share
                });
            }
        }
        let [x, y, weight] = near[degree];
        [x / weight, y / weight]
    }
}
