//! The table of G and M words: what each means, by dialect, or why it is let pass or refused.
//!
//! The one place for this. The interpreter looks words up here and the table in the README is printed from here, so that what is
//! documented is what is done. A word that stands in no row is refused.

use super::dialect::Dialect;
use super::path::Plane;

/// A G or M word. `G91.1` is 911 tenths.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Code {
    /// `G` or `M`.
    pub(super) letter: char,
    pub(super) tenths: u16,
    /// From 1, in bytes.
    pub(super) column: u32,
}

impl std::fmt::Display for Code {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&name(self.letter, self.tenths))
    }
}

fn name(letter: char, tenths: u16) -> String {
    match tenths % 10 {
        0 => format!("{letter}{}", tenths / 10),
        tenth => format!("{letter}{}.{tenth}", tenths / 10),
    }
}

/// What makes the cutter move when coordinates follow.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum MotionWord {
    Rapid,
    Straight,
    Arc { counterclockwise: bool },
    Cubic,
    Quadratic,
    Nurbs,
    Cycle(Cycle),
}

/// The canned cycles.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Cycle {
    /// G81: down, up fast.
    Drill,
    /// G82: down, a dwell, up fast.
    DrillDwell,
    /// G83: in steps, each cleared up to R.
    Peck,
    /// G73: in steps, each with a small lift.
    ChipBreak,
    /// G84, G74: down and up at the feed, the spindle turned round at the bottom.
    Tap,
    /// G85: down and up to R at the feed.
    Bore,
    /// G89: down, a dwell, up at the feed.
    BoreDwell,
    /// G86: down at the feed, up fast with the spindle stopped.
    BoreStop,
}

/// Which way the tool's length is taken into account.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Length {
    /// G43.
    Table,
    /// G43.1.
    Given,
    /// G43.2.
    Added,
    /// G49.
    None,
}

/// On which side of the path the cutter runs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Side {
    Left,
    Right,
}

/// What a word does.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Action {
    Nothing,
    Motion(MotionWord),
    NoMotion,
    NurbsEnd,
    Dwell,
    Set,
    Plane(Plane),
    /// Millimetres in the program's unit.
    Unit(f64),
    Compensation {
        side: Option<Side>,
        given: bool,
    },
    Length(Length),
    Home {
        second: bool,
    },
    HomeHere {
        second: bool,
    },
    Machine,
    /// G54 is 0.
    System(usize),
    Absolute(bool),
    CentresAbsolute(bool),
    Shift,
    ShiftDirectly,
    ShiftEnd {
        keep: bool,
    },
    ShiftResume,
    FeedPerMinute,
    FeedInverseTime,
    FeedPerTurn,
    RetractToR(bool),
    Spindle(bool),
    Change,
    ToolIs,
    End,
    Save,
    SaveUntilReturn,
    Restore,
    Forget,
    Call,
    CallLine,
    Return,
}

/// How a word is treated.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Treatment {
    /// Done as written.
    Understood(Action),
    /// Changes nothing of the path, so nothing is done and nothing said.
    Harmless,
    /// Not done and said so, once: the path is right, something else may not be.
    Reported(&'static str),
    /// The path would be wrong, so the program is refused.
    Refused(&'static str),
}

/// A row of the table: words from `first` to `last` in tenths, in some dialects.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    letter: char,
    first: u16,
    last: u16,
    dialects: u8,
    pub(super) treatment: Treatment,
    meaning: &'static str,
}

const ALL: u8 = 0b11_1111;
const LINUXCNC: u8 = Dialect::LinuxCnc.bit();
const FANUC: u8 = Dialect::Fanuc.bit() | Dialect::Haas.bit();
const HAAS: u8 = Dialect::Haas.bit();
const MARLIN: u8 = Dialect::Marlin.bit();
const MACH3: u8 = Dialect::Mach3.bit();

const fn row(
    letter: char,
    (first, last): (u16, u16),
    dialects: u8,
    treatment: Treatment,
    meaning: &'static str,
) -> Row {
    Row {
        letter,
        first,
        last,
        dialects,
        treatment,
        meaning,
    }
}

const fn does(letter: char, tenths: u16, action: Action, meaning: &'static str) -> Row {
    row(
        letter,
        (tenths, tenths),
        ALL,
        Treatment::Understood(action),
        meaning,
    )
}

const fn harmless(letter: char, span: (u16, u16), dialects: u8, meaning: &'static str) -> Row {
    row(letter, span, dialects, Treatment::Harmless, meaning)
}

const fn refused(letter: char, span: (u16, u16), dialects: u8, why: &'static str) -> Row {
    row(letter, span, dialects, Treatment::Refused(why), why)
}

const fn reported(letter: char, span: (u16, u16), dialects: u8, what: &'static str) -> Row {
    row(letter, span, dialects, Treatment::Reported(what), what)
}

use Action as A;
use MotionWord as W;

const LATHE: &str = "a word of lathes; only milling is supported";
const SYNCHRONOUS: &str = "threading in step with the spindle is not supported";
const PROBING: &str = "probing is not supported: where it ends is not known";

/// The first row that has the word and the dialect counts.
pub(super) const ROWS: &[Row] = &[
    does('G', 0, A::Motion(W::Rapid), "rapid"),
    does('G', 10, A::Motion(W::Straight), "straight feed"),
    does(
        'G',
        20,
        A::Motion(W::Arc {
            counterclockwise: false,
        }),
        "clockwise arc or helix",
    ),
    does(
        'G',
        30,
        A::Motion(W::Arc {
            counterclockwise: true,
        }),
        "counterclockwise arc or helix",
    ),
    does('G', 40, A::Dwell, "dwell"),
    harmless('G', (50, 50), FANUC, "high-speed mode (P10000, P0)"),
    does('G', 50, A::Motion(W::Cubic), "cubic spline"),
    harmless('G', (51, 51), FANUC, "contour control (Q1, Q0)"),
    does('G', 51, A::Motion(W::Quadratic), "quadratic spline"),
    does('G', 52, A::Motion(W::Nurbs), "NURBS"),
    does('G', 53, A::NurbsEnd, "end of a NURBS"),
    refused('G', (70, 70), LINUXCNC, LATHE),
    harmless(
        'G',
        (80, 80),
        LINUXCNC,
        "radius mode of lathes, the same on a mill",
    ),
    harmless('G', (80, 80), FANUC, "high-precision mode"),
    harmless('G', (90, 90), FANUC | MACH3, "exact stop"),
    refused(
        'G',
        (100, 110),
        MARLIN,
        "retracting filament is a printer's word",
    ),
    does(
        'G',
        100,
        A::Set,
        "set coordinate systems (L2, L20) or tools (L1, L10, L11)",
    ),
    harmless('G', (110, 110), FANUC, "end of setting data"),
    refused(
        'G',
        (120, 130),
        ALL,
        "circular pockets are not supported; have them written as G2 and G3",
    ),
    harmless('G', (150, 150), ALL, "no polar coordinates"),
    refused(
        'G',
        (160, 160),
        ALL,
        "polar coordinates by G16 are not supported; LinuxCNC's @ and ^ are",
    ),
    does('G', 170, A::Plane(Plane::Xy), "plane XY"),
    does('G', 180, A::Plane(Plane::Zx), "plane ZX"),
    does('G', 190, A::Plane(Plane::Yz), "plane YZ"),
    does('G', 200, A::Unit(25.4), "inches"),
    does('G', 210, A::Unit(1.0), "millimetres"),
    does(
        'G',
        280,
        A::Home { second: false },
        "return to the reference point",
    ),
    does(
        'G',
        281,
        A::HomeHere { second: false },
        "the reference point is here",
    ),
    refused(
        'G',
        (290, 290),
        ALL,
        "a path from the reference point or a probed bed is not supported",
    ),
    does(
        'G',
        300,
        A::Home { second: true },
        "return to the second reference point",
    ),
    does(
        'G',
        301,
        A::HomeHere { second: true },
        "the second reference point is here",
    ),
    refused('G', (310, 319), ALL, PROBING),
    refused('G', (330, 339), ALL, SYNCHRONOUS),
    refused('G', (380, 389), ALL, PROBING),
    does(
        'G',
        400,
        A::Compensation {
            side: None,
            given: false,
        },
        "no cutter compensation",
    ),
    does(
        'G',
        410,
        A::Compensation {
            side: Some(Side::Left),
            given: false,
        },
        "cutter left of the path",
    ),
    does(
        'G',
        411,
        A::Compensation {
            side: Some(Side::Left),
            given: true,
        },
        "cutter left of the path, diameter D",
    ),
    does(
        'G',
        420,
        A::Compensation {
            side: Some(Side::Right),
            given: false,
        },
        "cutter right of the path",
    ),
    does(
        'G',
        421,
        A::Compensation {
            side: Some(Side::Right),
            given: true,
        },
        "cutter right of the path, diameter D",
    ),
    does(
        'G',
        430,
        A::Length(Length::Table),
        "tool length from the table",
    ),
    does(
        'G',
        431,
        A::Length(Length::Given),
        "tool length by axis words",
    ),
    does(
        'G',
        432,
        A::Length(Length::Added),
        "one more tool length from the table",
    ),
    refused(
        'G',
        (433, 439),
        ALL,
        "tool centre point control is not supported",
    ),
    refused(
        'G',
        (440, 440),
        ALL,
        "tool lengths counted downwards are not supported",
    ),
    refused('G', (470, 470), FANUC, "engraving text is not supported"),
    does('G', 490, A::Length(Length::None), "no tool length"),
    harmless('G', (500, 500), ALL, "no scaling"),
    refused(
        'G',
        (510, 511),
        ALL,
        "scaling and mirroring are not supported",
    ),
    does('G', 520, A::ShiftDirectly, "shift of the coordinates"),
    does('G', 530, A::Machine, "machine coordinates for one line"),
    does('G', 540, A::System(0), "work system 1"),
    does('G', 550, A::System(1), "work system 2"),
    does('G', 560, A::System(2), "work system 3"),
    does('G', 570, A::System(3), "work system 4"),
    does('G', 580, A::System(4), "work system 5"),
    does('G', 590, A::System(5), "work system 6"),
    does('G', 591, A::System(6), "work system 7"),
    does('G', 592, A::System(7), "work system 8"),
    does('G', 593, A::System(8), "work system 9"),
    harmless('G', (610, 611), ALL, "exact path or exact stop"),
    harmless('G', (620, 620), FANUC, "slower at corners"),
    harmless(
        'G',
        (640, 640),
        ALL,
        "path blending: its rounding of corners, at most P, is left out",
    ),
    refused('G', (650, 660), ALL, "macro calls are not supported"),
    harmless('G', (670, 670), FANUC, "end of macro calls"),
    refused(
        'G',
        (680, 682),
        ALL,
        "rotated coordinates by G68 are not supported; G10 L2 R is",
    ),
    harmless('G', (690, 690), ALL, "no rotation"),
    refused(
        'G',
        (700, 722),
        ALL,
        "a cycle of lathes or a pattern of holes is not supported",
    ),
    does(
        'G',
        730,
        A::Motion(W::Cycle(Cycle::ChipBreak)),
        "drilling with chip breaking",
    ),
    does(
        'G',
        740,
        A::Motion(W::Cycle(Cycle::Tap)),
        "tapping, left hand",
    ),
    refused(
        'G',
        (760, 760),
        ALL,
        "threading (lathes) or fine boring with a sideways move is not supported",
    ),
    does('G', 800, A::NoMotion, "end of a cycle"),
    does('G', 810, A::Motion(W::Cycle(Cycle::Drill)), "drilling"),
    does(
        'G',
        820,
        A::Motion(W::Cycle(Cycle::DrillDwell)),
        "drilling with a dwell",
    ),
    does(
        'G',
        830,
        A::Motion(W::Cycle(Cycle::Peck)),
        "drilling in pecks",
    ),
    does('G', 840, A::Motion(W::Cycle(Cycle::Tap)), "tapping"),
    does(
        'G',
        850,
        A::Motion(W::Cycle(Cycle::Bore)),
        "boring, out at the feed",
    ),
    does(
        'G',
        860,
        A::Motion(W::Cycle(Cycle::BoreStop)),
        "boring, spindle stopped, out fast",
    ),
    refused(
        'G',
        (870, 880),
        ALL,
        "back boring and boring with a manual return are not supported: where the tool goes is not known",
    ),
    does(
        'G',
        890,
        A::Motion(W::Cycle(Cycle::BoreDwell)),
        "boring with a dwell, out at the feed",
    ),
    does('G', 900, A::Absolute(true), "absolute"),
    does('G', 901, A::CentresAbsolute(true), "arc centres absolute"),
    does('G', 910, A::Absolute(false), "relative"),
    does(
        'G',
        911,
        A::CentresAbsolute(false),
        "arc centres relative to the start",
    ),
    does('G', 920, A::Shift, "the cutter is at these coordinates"),
    does('G', 921, A::ShiftEnd { keep: false }, "no shift"),
    does('G', 922, A::ShiftEnd { keep: true }, "no shift for now"),
    does('G', 923, A::ShiftResume, "the shift again"),
    does('G', 930, A::FeedInverseTime, "feed as moves a minute"),
    does('G', 940, A::FeedPerMinute, "feed a minute"),
    does('G', 950, A::FeedPerTurn, "feed a turn of the spindle"),
    refused(
        'G',
        (960, 960),
        ALL,
        "constant surface speed is for lathes; only milling is supported",
    ),
    harmless('G', (970, 970), ALL, "turns a minute"),
    does(
        'G',
        980,
        A::RetractToR(false),
        "cycles return to where they began",
    ),
    does('G', 990, A::RetractToR(true), "cycles return to R"),
    harmless('G', (1030, 1030), HAAS, "lines read ahead"),
    harmless('G', (1870, 1870), HAAS, "smoothness"),
    harmless('M', (0, 10), ALL, "stop"),
    does('M', 20, A::End, "end"),
    does('M', 30, A::Spindle(true), "spindle clockwise"),
    does('M', 40, A::Spindle(true), "spindle counterclockwise"),
    does('M', 50, A::Spindle(false), "spindle stops"),
    does('M', 60, A::Change, "tool change"),
    harmless('M', (70, 90), ALL, "coolant"),
    reported(
        'M',
        (100, 110),
        ALL,
        "not done: clamps, or a laser or torch of some machines; the cutter is taken to cut at every feed",
    ),
    harmless('M', (160, 190), ALL, "tool pocket, powder, orientation"),
    does('M', 300, A::End, "end"),
    harmless('M', (310, 420), ALL, "chip conveyor, gears"),
    refused(
        'M',
        (470, 470),
        ALL,
        "running again from the start is not supported",
    ),
    harmless('M', (480, 530), ALL, "overrides"),
    harmless('M', (600, 600), ALL, "stop"),
    does('M', 610, A::ToolIs, "the tool in the spindle is Q"),
    reported(
        'M',
        (620, 680),
        ALL,
        "not done: outputs and inputs of the machine; the cutter is taken to cut at every feed",
    ),
    does('M', 700, A::Save, "save modes"),
    does('M', 710, A::Forget, "forget saved modes"),
    does('M', 720, A::Restore, "restore modes"),
    does('M', 730, A::SaveUntilReturn, "save modes until the return"),
    harmless('M', (820, 840), ALL, "extruder, motors"),
    harmless('M', (880, 890), ALL, "coolant through the spindle"),
    does('M', 970, A::CallLine, "call of the lines from N on"),
    does('M', 980, A::Call, "call of a program"),
    does('M', 990, A::Return, "return"),
    reported(
        'M',
        (1000, 1970),
        LINUXCNC | FANUC | MACH3 | Dialect::Grbl.bit(),
        "not run: a word of this machine's own, taken not to move the cutter",
    ),
    refused(
        'M',
        (1980, 1990),
        ALL,
        "calls of programs that are not in this file are not supported",
    ),
    reported(
        'M',
        (1000, 9990),
        MARLIN,
        "ignored: a word of printers, taken not to move the cutter",
    ),
];

/// The rows of one dialect, found by letter and tenths.
#[derive(Clone, Debug)]
pub(super) struct Codes {
    /// One more than the place in [`ROWS`]; 0 where there is no row.
    general: Vec<u8>,
    miscellaneous: Vec<u8>,
}

const _: () = assert!(ROWS.len() < 255);

impl Codes {
    pub(super) fn of(dialect: Dialect) -> Self {
        let mut codes = Self {
            general: vec![0; 10_000],
            miscellaneous: vec![0; 10_000],
        };
        // From the last to the first, so that the first counts.
        for (number, row) in (1..=u8::MAX).zip(ROWS).rev() {
            let list = match row.letter {
                'G' => &mut codes.general,
                _ => &mut codes.miscellaneous,
            };
            // A row from M7 to M9 does not mean M7.5.
            let whole = row.first % 10 == 0 && row.last % 10 == 0;
            if row.dialects & dialect.bit() != 0 {
                for tenths in (row.first..=row.last).step_by(if whole { 10 } else { 1 }) {
                    list[usize::from(tenths)] = number;
                }
            }
        }
        codes
    }

    /// How a word is treated.
    pub(super) fn treatment(&self, code: Code) -> Treatment {
        let list = match code.letter {
            'G' => &self.general,
            _ => &self.miscellaneous,
        };
        match list.get(usize::from(code.tenths)) {
            None | Some(0) => Treatment::Refused("this word is not known"),
            Some(&number) => ROWS[usize::from(number) - 1].treatment,
        }
    }
}

/// The table of words as Markdown: a row for each word or run of words, a column for each dialect.
pub fn words_table() -> String {
    use std::fmt::Write;
    let mut text = String::from("| words | meaning |");
    for dialect in Dialect::ALL {
        write!(text, " {} |", dialect.name()).expect("a string takes everything");
    }
    text.push_str("\n|---|---|");
    text.push_str(&"---|".repeat(Dialect::ALL.len()));
    text.push('\n');
    for (place, row) in ROWS.iter().enumerate() {
        let mut words = name(row.letter, row.first);
        if row.last != row.first {
            write!(words, " to {}", name(row.letter, row.last)).expect("a string takes everything");
        }
        write!(text, "| {words} | {} |", row.meaning).expect("a string takes everything");
        for dialect in Dialect::ALL {
            let earlier = ROWS[..place].iter().any(|other| {
                other.letter == row.letter
                    && other.dialects & dialect.bit() != 0
                    && other.first <= row.first
                    && row.last <= other.last
            });
            let said = match row.treatment {
                _ if row.dialects & dialect.bit() == 0 || earlier => "",
                Treatment::Understood(_) => "done",
                Treatment::Harmless => "harmless",
                Treatment::Reported(_) => "reported",
                Treatment::Refused(_) => "refused",
            };
            write!(text, " {said} |").expect("a string takes everything");
        }
        text.push('\n');
    }
    text
}
