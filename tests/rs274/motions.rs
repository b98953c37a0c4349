//! Motions as both interpreters say them, and whether they agree.

use std::path::Path;

use union3d::toolpath::{self, Dialect, Event, Interpreter, Options, ToolTable};

/// How far two ends may be apart. Units: mm.
pub(crate) const TOLERANCE: f64 = 1e-4;

#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum Kind {
    Rapid,
    Feed,
    Arc {
        /// On the axes of the plane.
        centre: [f64; 2],
        plane: [usize; 2],
        turns: f64,
    },
    /// Of which the judge says no more than that it is one.
    Spline,
    Dwell {
        seconds: f64,
    },
}

/// One motion, in mm.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Motion {
    pub(crate) kind: Kind,
    pub(crate) end: [f64; 3],
    pub(crate) tool: u32,
    pub(crate) feed: f64,
}

/// Our motions of a program, and why it was refused if it was.
pub(crate) fn ours(program: &Path) -> (Vec<Motion>, Option<String>) {
    let options = Options {
        dialect: Some(Dialect::LinuxCnc),
        tools: tools(),
        origins: [Some([0.0; 3]); 9],
        directory: program.parent().map(Path::to_owned),
        ..Options::default()
    };
    let mut motions = Vec::new();
    for event in Interpreter::new(std::fs::read(program).unwrap(), options) {
        match event {
            Ok(Event::Move(next)) => {
                let kind = match next.motion {
                    toolpath::Motion::Rapid => Kind::Rapid,
                    toolpath::Motion::Feed => Kind::Feed,
                    toolpath::Motion::Arc => {
                        let plane = next.plane().unwrap().axes();
                        Kind::Arc {
                            centre: plane.map(|axis| next.center().unwrap()[axis]),
                            plane,
                            turns: f64::from(next.turns().unwrap()),
                        }
                    }
                };
                motions.push(Motion {
                    kind,
                    end: next.end,
                    tool: next.tool,
                    feed: next.feed.unwrap_or(0.0),
                });
            }
            Ok(Event::Dwell { tool, seconds, .. }) => motions.push(Motion {
                kind: Kind::Dwell { seconds },
                end: motions.last().map_or([0.0; 3], |motion| motion.end),
                tool,
                feed: 0.0,
            }),
            Ok(Event::Warning(_)) => {}
            Err(fault) => return (motions, Some(fault.to_string())),
        }
    }
    (motions, None)
}

fn tools() -> ToolTable {
    let mut tools = ToolTable::default();
    for (number, length, diameter) in crate::judge::TOOLS {
        let tool = tools.entry(number);
        tool.diameter = Some(diameter * 25.4);
        tool.offset = [0.0, 0.0, length * 25.4];
    }
    tools
}

/// Leaves out what does not move: the judge repeats ends here and there.
fn moving(motions: &[Motion]) -> Vec<Motion> {
    let mut last = [0.0; 3];
    let mut kept = Vec::new();
    for motion in motions {
        let stays = matches!(motion.kind, Kind::Rapid | Kind::Feed) && near(&motion.end, &last);
        last = motion.end;
        if !stays {
            kept.push(*motion);
        }
    }
    kept
}

fn near(one: &[f64], other: &[f64]) -> bool {
    one.iter()
        .zip(other)
        .all(|(one, other)| (one - other).abs() < TOLERANCE)
}

/// The first place where two lists differ: its number and both motions. If one of them was `stopped`, the other may be longer.
pub(crate) fn difference(judge: &[Motion], ours: &[Motion], stopped: bool) -> Option<String> {
    let (judge, ours) = (moving(judge), moving(ours));
    let mut own = ours.iter().peekable();
    for (number, expected) in judge.iter().enumerate() {
        if expected.kind == Kind::Spline {
            // Its chords are as many feeds as it takes: those up to the next motion that is not a feed, or that the judge says.
            let next = judge[number..]
                .iter()
                .find(|next| next.kind != Kind::Spline);
            while own.peek().is_some_and(|found| {
                found.kind == Kind::Feed && next.is_none_or(|next| !agree(next, found))
            }) {
                own.next();
            }
            continue;
        }
        match own.next() {
            Some(found) if agree(expected, found) => {}
            None if stopped => return None,
            found => {
                return Some(format!(
                    "motion {number}: judge {expected:?}\n          ours  {found:?}"
                ));
            }
        }
    }
    own.next().filter(|_| !stopped).map(|more| {
        format!(
            "motion {}: judge none\n          ours  {more:?}",
            judge.len()
        )
    })
}

fn agree(judge: &Motion, ours: &Motion) -> bool {
    let kinds = match (judge.kind, ours.kind) {
        (
            Kind::Arc {
                centre,
                plane,
                turns,
            },
            Kind::Arc {
                centre: second,
                plane: other,
                turns: count,
            },
        ) => near(&centre, &second) && plane == other && turns == count,
        (Kind::Dwell { seconds }, Kind::Dwell { seconds: second }) => near(&[seconds], &[second]),
        (one, other) => one == other,
    };
    let ends = matches!(judge.kind, Kind::Dwell { .. }) || near(&judge.end, &ours.end);
    kinds && ends && judge.tool == ours.tool
}
