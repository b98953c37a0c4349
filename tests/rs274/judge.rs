//! `rs274`, the interpreter of `LinuxCNC` (Debian's package linuxcnc-uspace), and its canonical calls as motions.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::motions::{Kind, Motion};

/// The tools both sides know, in inches as the machine of `rs274` has them: number, length, diameter.
pub(crate) const TOOLS: [(u32, f64, f64); 6] = [
    (1, -1.5, 0.25),
    (2, 2.5, 0.125),
    (3, 0.0, 0.0625),
    (7, 0.75, 0.5),
    (4, 0.5, 0.1875),
    (99, 0.0, 0.375),
];

const MM_PER_INCH: f64 = 25.4;

/// An `rs274` that prints nine decimals, and its files.
pub(crate) struct Judge {
    directory: tempfile::TempDir,
    program: PathBuf,
}

/// What the judge says of a program.
pub(crate) struct Verdict {
    pub(crate) motions: Vec<Motion>,
    /// Why it stopped, if it did not come to the end.
    pub(crate) error: Option<String>,
}

impl Judge {
    /// None when it is not installed. Four decimals of an inch are too coarse to compare with, so the formats in a copy of the
    /// program are changed.
    pub(crate) fn new() -> Option<Self> {
        let mut program = fs::read("/usr/bin/rs274").ok()?;
        for at in 0..program.len() - 4 {
            if &program[at..at + 4] == b"%.4f" {
                program[at + 2] = b'9';
            }
        }
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("rs274");
        fs::write(&path, program).unwrap();
        let mut permissions = fs::metadata(&path).unwrap().permissions();
        std::os::unix::fs::PermissionsExt::set_mode(&mut permissions, 0o755);
        fs::set_permissions(&path, permissions).unwrap();
        let rows = TOOLS.map(|(number, length, diameter)| {
            format!("T{number} P{number} Z{length} D{diameter}\n")
        });
        fs::write(directory.path().join("tool.tbl"), rows.concat()).unwrap();
        Some(Self {
            directory,
            program: path,
        })
    }

    /// Runs a program in the directory it stands in.
    pub(crate) fn run(&self, program: &Path) -> Verdict {
        let parameters = self.directory.path().join("parameters.var");
        fs::write(&parameters, "").unwrap();
        let output = Command::new("timeout")
            .arg("20")
            .arg(&self.program)
            .args(["-g", "-t"])
            .arg(self.directory.path().join("tool.tbl"))
            .arg("-v")
            .arg(&parameters)
            .arg(program)
            .current_dir(program.parent().unwrap())
            // It shares its tools through a file there.
            .env("HOME", self.directory.path())
            .output()
            .unwrap();
        let mut canon = Canon::default();
        for line in String::from_utf8_lossy(&output.stdout).lines() {
            canon.take(line);
        }
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let said: Vec<_> = said
            .lines()
            .filter(|line| !line.trim().is_empty() && *line != "executing")
            .collect();
        let error =
            (!output.status.success()).then(|| format!("{}: {}", output.status, said.join(" / ")));
        Verdict {
            motions: canon.motions,
            error,
        }
    }
}

/// The state of the canonical machine, in mm.
#[derive(Default)]
struct Canon {
    inches: bool,
    origin: [f64; 3],
    shift: [f64; 3],
    degrees: f64,
    length: [f64; 3],
    plane: usize,
    feed: f64,
    tool: u32,
    base: Option<[f64; 3]>,
    /// Of the tip, in the machine's coordinates.
    last: [f64; 3],
    motions: Vec<Motion>,
}

/// First, second and normal axis of XY, YZ and XZ.
const PLANES: [[usize; 3]; 3] = [[0, 1, 2], [1, 2, 0], [2, 0, 1]];

impl Canon {
    fn take(&mut self, line: &str) {
        let Some((_, call)) = line.split_once(" N") else {
            return;
        };
        let Some((_, call)) = call.split_once(' ') else {
            return;
        };
        let call = call.trim();
        let Some((name, arguments)) = call.split_once('(') else {
            return;
        };
        let unit = if self.inches { MM_PER_INCH } else { 1.0 };
        let numbers: Vec<f64> = arguments
            .trim_end_matches(')')
            .split([',', ' '])
            .filter_map(|number| number.trim().parse().ok())
            .collect();
        let three = |from: usize| [0, 1, 2].map(|axis| numbers[from + axis] * unit);
        match name {
            "USE_LENGTH_UNITS" => self.inches = arguments.contains("INCHES"),
            "SET_G5X_OFFSET" => self.origin = three(1),
            "SET_G92_OFFSET" => self.shift = three(0),
            "SET_XY_ROTATION" => self.degrees = numbers[0],
            "USE_TOOL_LENGTH_OFFSET" => {
                let length = three(0);
                for (axis, last) in self.last.iter_mut().enumerate() {
                    *last += self.length[axis] - length[axis];
                }
                self.length = length;
            }
            "SELECT_PLANE" => {
                self.plane = ["XY", "YZ", "XZ"]
                    .iter()
                    .position(|name| arguments.contains(name))
                    .unwrap();
            }
            "SET_FEED_RATE" => self.feed = numbers[0] * unit,
            // It names the row of the table.
            "CHANGE_TOOL" => {
                let row = numbers[0] as usize;
                self.tool = row.checked_sub(1).map_or(0, |row| TOOLS[row].0);
            }
            "STRAIGHT_TRAVERSE" => self.straight(Kind::Rapid, three(0)),
            "STRAIGHT_FEED" => self.straight(Kind::Feed, three(0)),
            "ARC_FEED" => {
                let [first, second, normal] = PLANES[self.plane];
                let mut end = [0.0; 3];
                (end[first], end[second], end[normal]) =
                    (numbers[0] * unit, numbers[1] * unit, numbers[5] * unit);
                let mut centre = [0.0; 3];
                (centre[first], centre[second]) = (numbers[2] * unit, numbers[3] * unit);
                let (end, centre) = (self.placed(end), self.placed(centre));
                let kind = Kind::Arc {
                    centre: [centre[first], centre[second]],
                    plane: [first, second],
                    turns: numbers[4],
                };
                self.push(kind, end);
            }
            "NURBS_FEED" => self.motions.push(Motion {
                kind: Kind::Spline,
                end: self.last,
                tool: self.tool,
                feed: self.feed,
            }),
            "DWELL" => self.motions.push(Motion {
                kind: Kind::Dwell {
                    seconds: numbers[0],
                },
                end: self.last,
                tool: self.tool,
                feed: 0.0,
            }),
            _ => {}
        }
    }

    fn placed(&mut self, point: [f64; 3]) -> [f64; 3] {
        let base = *self.base.get_or_insert(self.origin);
        let [x, y, z] = [0, 1, 2].map(|axis| point[axis] + self.shift[axis]);
        let (sine, cosine) = self.degrees.to_radians().sin_cos();
        let turned = [x * cosine - y * sine, x * sine + y * cosine, z];
        [0, 1, 2].map(|axis| turned[axis] + self.origin[axis] - base[axis])
    }

    fn straight(&mut self, kind: Kind, end: [f64; 3]) {
        let end = self.placed(end);
        self.push(kind, end);
    }

    fn push(&mut self, kind: Kind, end: [f64; 3]) {
        self.last = end;
        self.motions.push(Motion {
            kind,
            end,
            tool: self.tool,
            feed: self.feed,
        });
    }
}
