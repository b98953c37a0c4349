//! When a machine with bounded acceleration is done with each move.
//!
//! Speeds along the path are trapezoids: up, along at the feed, down. How fast a corner is passed is what a circle allows that touches both
//! sides and stays within the junction deviation of the corner, with the acceleration as centripetal acceleration. Arcs are passed no faster than
//! that acceleration allows either. The machine stands still at dwells, at changes of the tool, and where the program does not say from where a move
//! comes or how fast it is.
//!
//! # Source
//! Grbl's planner: junction deviation, a backward and a forward pass over all moves.

use union3d::toolpath::Move;

/// A machine that takes its time to get going. Units: mm, seconds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Machine {
    pub(super) acceleration: f64,
    pub(super) junction_deviation: f64,
}

/// A move and what bounds its speed. Units: mm, seconds.
struct Block {
    length: f64,
    speed: f64,
    /// Squares of the speeds at both ends.
    ends: [f64; 2],
}

/// Fills in the times of moves in their order, given those without acceleration; a move without time has none. Moves are `None` where the
/// machine stands still.
pub(super) fn accelerate(moves: &[Option<&Move>], seconds: &mut [Option<f64>], machine: Machine) {
    let mut run: Vec<(usize, Block, [[f64; 3]; 2])> = Vec::new();
    for (index, next) in moves.iter().enumerate() {
        let block = next.and_then(|next| block(next, seconds[index], machine));
        let joined = run.last().is_some_and(|(last, ..)| {
            let last = moves[*last].expect("it is in the run");
            next.is_some_and(|next| next.tool == last.tool && next.start_known)
        });
        if !joined || block.is_none() {
            // A move without length stands nowhere; everything else that is no block is a stop.
            if next.is_some_and(|next| next.length == 0.0 && joined) {
                continue;
            }
            finish(&mut run, seconds, machine);
        }
        if let Some((mut block, directions)) = block {
            if let Some((_, before, [_, last])) = run.last_mut() {
                let most = junction(*last, directions[0], machine)
                    .min(before.speed * before.speed)
                    .min(block.speed * block.speed);
                (before.ends[1], block.ends[0]) = (most, most);
            }
            run.push((index, block, directions));
        }
    }
    finish(&mut run, seconds, machine);
}

fn block(next: &Move, seconds: Option<f64>, machine: Machine) -> Option<(Block, [[f64; 3]; 2])> {
    let seconds = seconds.filter(|seconds| *seconds > 0.0)?;
    let directions = next.directions()?;
    let mut speed = next.length / seconds;
    if let Some(radius) = next.radius() {
        speed = speed.min((machine.acceleration * radius).sqrt());
    }
    let block = Block {
        length: next.length,
        speed,
        ends: [0.0; 2],
    };
    Some((block, directions))
}

/// The square of the greatest speed at a corner.
fn junction(from: [f64; 3], to: [f64; 3], machine: Machine) -> f64 {
    // Of the angle between the sides of the corner.
    let cosine = -(0..3).map(|axis| from[axis] * to[axis]).sum::<f64>();
    let sine_of_half = ((1.0 - cosine) / 2.0).max(0.0).sqrt();
    if sine_of_half > 1.0 - 1e-9 {
        return f64::INFINITY;
    }
    machine.acceleration * machine.junction_deviation * sine_of_half / (1.0 - sine_of_half)
}

/// The times of a run of moves that begins and ends at a standstill.
fn finish(
    run: &mut Vec<(usize, Block, [[f64; 3]; 2])>,
    seconds: &mut [Option<f64>],
    machine: Machine,
) {
    let doubled = 2.0 * machine.acceleration;
    for index in (0..run.len()).rev() {
        if let Some((_, after, _)) = run.get(index + 1) {
            run[index].1.ends[1] = after.ends[0];
        }
        let block = &mut run[index].1;
        block.ends[0] = block.ends[0].min(block.ends[1] + doubled * block.length);
    }
    let mut start = 0.0;
    for (index, block, _) in run.drain(..) {
        let from: f64 = start;
        let to = block.ends[1].min(from + doubled * block.length);
        start = to;
        let peak = f64::midpoint(from, to) + machine.acceleration * block.length;
        let peak = peak.min(block.speed * block.speed);
        let ramps = (2.0 * peak - from - to) / doubled;
        let (entry, exit, top) = (from.sqrt(), to.sqrt(), peak.sqrt());
        let along = (block.length - ramps).max(0.0) / top;
        seconds[index] = Some((2.0 * top - entry - exit) / machine.acceleration + along);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use union3d::toolpath::{Event, Interpreter, Options};

    const MACHINE: Machine = Machine {
        acceleration: 100.0,
        junction_deviation: 0.01,
    };

    /// Times of the moves of a program, feeds in mm a minute.
    fn times(program: &str) -> Vec<f64> {
        let moves: Vec<Move> = Interpreter::new(program, Options::default())
            .filter_map(|event| match event.unwrap() {
                Event::Move(next) => Some(next),
                _ => None,
            })
            .collect();
        let mut seconds: Vec<Option<f64>> = moves
            .iter()
            .map(|next| next.feed.map(|feed| next.length / feed * 60.0))
            .collect();
        let all: Vec<Option<&Move>> = moves.iter().map(Some).collect();
        accelerate(&all, &mut seconds, MACHINE);
        seconds.into_iter().map(Option::unwrap).collect()
    }

    #[track_caller]
    fn check(program: &str, expected: &[f64]) {
        let found = times(&format!("G21 G90 G17\nG1 F600 X0 Y0 Z0\n{program}"));
        assert_eq!(found.len(), expected.len() + 1, "{program}");
        for (found, expected) in found[1..].iter().zip(expected) {
            assert!(
                (found - expected).abs() < 1e-9,
                "{program}: {found} {expected}"
            );
        }
    }

    #[test]
    fn a_line_is_a_trapezoid() {
        // 10 mm/s after 0.1 s and 0.5 mm, and as much to stop: 9 mm remain.
        check("X10", &[0.1 + 0.9 + 0.1]);
        // Too short for the feed: half of it up, half down, each sqrt(2 * 0.1 / 100).
        check("X0.2", &[2.0 * (0.2_f64 / 100.0).sqrt()]);
    }

    #[test]
    fn lines_in_one_direction_are_one() {
        let parts = times("G21\nG1 F600 X0 Y0 Z0\nX4\nX5\nX10");
        assert!(
            (parts[1..].iter().sum::<f64>() - 1.1).abs() < 1e-9,
            "{parts:?}"
        );
    }

    #[test]
    fn a_corner_is_passed_as_its_circle_allows() {
        // The speed at a right angle: v^2 = 100 * 0.01 * s / (1 - s) with s = sin 45 degrees.
        let sine = 0.5_f64.sqrt();
        let corner = (sine / (1.0 - sine)).sqrt();
        let half = 0.1 + (10.0 - corner) / 100.0;
        let ramps = 0.5 + (100.0 - corner * corner) / 200.0;
        let each = half + (10.0 - ramps) / 10.0;
        check("X10\nY10", &[each, each]);
        // Turning back is a stop.
        check("X10\nX0", &[1.1, 1.1]);
    }

    #[test]
    fn an_arc_is_no_faster_than_the_acceleration_allows() {
        // Radius 0.25: at most sqrt(25) = 5 mm/s, reached after 0.05 s.
        let length = std::f64::consts::PI * 0.5;
        check("G2 I0.25", &[0.1 + (length - 0.25) / 5.0]);
    }
}
