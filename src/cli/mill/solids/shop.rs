//! From the steps of a program to the solids that its tools sweep.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

use indicatif::ProgressBar;

use union3d::engine::solids::{self, SolidId};
use union3d::geometry::convex::{Deviation, Point};
use union3d::toolpath::{Move, Shaped, ToolTable, Warning};
use union3d::wire::solids::Scale;

use super::super::tally::Kind;
use super::super::{Args, Warnings, duration, kind, swept};
use super::bodies::{Body, Fineness, Swept, end_height};
use super::material::Blank;
use super::{Failure, Rounding, Step};

/// Bits of an id that number the solids of a line.
const NUMBER_BITS: u32 = 20;

/// A step of the program on the lattice.
pub(super) struct Stroke {
    pub(super) line: u64,
    pub(super) kind: Kind,
    /// Machine time; none when the program gives no feed.
    pub(super) duration: Option<Duration>,
    /// The number of its tool.
    pub(super) tool: u32,
    /// One for each chord that may meet the stock.
    pub(super) passes: Vec<Pass>,
}

/// A tool carried along a chord.
pub(super) struct Pass {
    /// What cuts.
    pub(super) flutes: Option<Cut>,
    /// Its shank and holder.
    pub(super) blunt: Option<Carried>,
}

/// A shape and the segment that it is carried along. What it sweeps is made where an engine needs it: a server makes its own.
#[derive(Clone)]
pub(super) struct Carried {
    pub(super) swept: Arc<Swept>,
    pub(super) ends: [Point; 2],
}

/// Flutes that are carried along a segment.
#[derive(Clone)]
pub(super) struct Cut {
    pub(super) id: SolidId,
    pub(super) carried: Carried,
}

impl Carried {
    /// What it sweeps.
    /// # Errors
    /// A sentence says why it cannot be there; `line` is that of the program.
    pub(super) fn body(&self, line: u64) -> Result<solids::Body, String> {
        let [from, to] = self.ends;
        solids::Body::swept(&self.swept.shape, from, to)
            .map_err(|invalid| format!("line {line}: {invalid}"))
    }
}

impl Stroke {
    /// What it cuts.
    pub(super) fn cuts(&self) -> impl Iterator<Item = &Cut> {
        self.passes.iter().filter_map(|pass| pass.flutes.as_ref())
    }
}

/// The id of a solid of a program: `line << 20 | number`, `number` counting the solids that the line has put down since the program began, from 0.
pub(super) fn id(line: u64, number: u64) -> Result<SolidId, String> {
    if number >> NUMBER_BITS == 0 && line >> (u64::BITS - NUMBER_BITS) == 0 {
        Ok(SolidId(line << NUMBER_BITS | number))
    } else {
        Err(format!(
            "line {line} puts down more than {} solids, which have no ids: take a greater --tolerance",
            1_u64 << NUMBER_BITS
        ))
    }
}

/// The line of the program that a solid came from when it was put down.
pub(super) fn line_of(id: SolidId) -> u64 {
    id.0 >> NUMBER_BITS
}

/// A shape to be carried from one point to another.
type Segment<'body> = (&'body Arc<Swept>, [Point; 2]);

/// Everything that cuts, and the stock.
pub(super) struct Shop<'run> {
    args: &'run Args,
    fineness: Fineness,
    pub(super) blank: Blank,
    top: Option<i32>,
    tools: ToolTable,
    /// Those that have cut.
    bodies: BTreeMap<u32, Arc<Body>>,
    deviation: Deviation,
    /// Solids put down so far by each line.
    put_down: HashMap<u64, u64>,
}

impl<'run> Shop<'run> {
    pub(super) fn new(
        args: &'run Args,
        scale: Scale,
        blank: Blank,
        tools: ToolTable,
    ) -> Result<Self, String> {
        let fineness = Fineness {
            steps_per_mm: f64::from(scale.steps_per_unit()) / args.unit.mm(),
            scale,
            sides: args.sides,
        };
        Ok(Self {
            args,
            fineness,
            top: common_top(&blank, &tools, fineness)?,
            blank,
            tools,
            bodies: BTreeMap::new(),
            deviation: Deviation::default(),
            put_down: HashMap::new(),
        })
    }

    /// How user units and steps correspond.
    pub(super) fn scale(&self) -> Scale {
        self.fineness.scale
    }

    /// Solids put down so far.
    pub(super) fn solids(&self) -> u64 {
        self.put_down.values().sum()
    }

    /// What a step does.
    pub(super) fn stroke(
        &mut self,
        step: &Step,
        seconds: Option<f64>,
        warnings: &mut Warnings,
        bar: &ProgressBar,
    ) -> Result<Stroke, Failure> {
        let line = step.line();
        let (kind, tool, swept) = match step {
            Step::Move(next) => (kind(next), next.tool, swept(next)),
            Step::Dwell { tool, .. } => (Kind::Dwell, *tool, None),
        };
        let cuts = match kind {
            Kind::Feed => true,
            Kind::Rapid => self.args.rapid || self.args.stock.is_some(),
            Kind::Dwell => false,
        };
        let mut passes = Vec::new();
        if let Some(swept) = swept.filter(|_| cuts)
            && let Some(body) = self.body(tool, line, kind, warnings, bar)?
        {
            passes = self.passes(&body, &swept)?;
        }
        Ok(Stroke {
            line,
            kind,
            duration: seconds.map(|seconds| duration(line, seconds)).transpose()?,
            tool,
            passes,
        })
    }

    /// A tool on the lattice. A rapid of one that is not defined hits nothing.
    fn body(
        &mut self,
        number: u32,
        line: u64,
        kind: Kind,
        warnings: &mut Warnings,
        bar: &ProgressBar,
    ) -> Result<Option<Arc<Body>>, String> {
        if let Some(body) = self.bodies.get(&number) {
            return Ok(Some(Arc::clone(body)));
        }
        let known = self.tools.get(number).map(|tool| tool.shape.clone());
        let shape = match known.unwrap_or_default() {
            Shaped::Given(shape) => shape,
            Shaped::Comment(shape, at) => {
                let warning = Warning {
                    line: at,
                    code: "tool-comment".into(),
                    text: format!("the shape of tool {number} is taken from this comment"),
                };
                if self.args.program.is_strict() {
                    return Err(warning.to_string());
                }
                warnings.add(warning, bar);
                shape
            }
            Shaped::Unknown | Shaped::Unsupported(_) if kind == Kind::Rapid => return Ok(None),
            Shaped::Unsupported(why) => {
                return Err(format!(
                    "line {line}: tool {number} cuts here without a shape: {why}; give it by --tool {}flat:6 or the like",
                    numbered(number)
                ));
            }
            Shaped::Unknown => {
                return Err(format!(
                    "line {line}: tool {number} cuts here and is not defined: give it by --tool {}flat:6 or the like, or by --tools; --edge is a square cutter",
                    numbered(number)
                ));
            }
        };
        if self.top.is_none() && shape.flutes.or(shape.length).is_none() {
            return Err(format!(
                "line {line}: how far up tool {number} cuts is not known, and there is no --stock: give it a length, such as --tool {}flat:6,length=22",
                numbered(number)
            ));
        }
        let body = Body::new(number, &shape, self.fineness, self.top)
            .map_err(|wrong| format!("tool {number}: {wrong}"))?;
        self.deviation = self.deviation.max(body.deviation);
        let body = Arc::new(body);
        self.bodies.insert(number, Arc::clone(&body));
        Ok(Some(body))
    }

    /// A tool carried along a move.
    fn passes(&mut self, body: &Body, next: &Move) -> Result<Vec<Pass>, String> {
        let about = |wrong: String| format!("line {}: {wrong}", next.line);
        let mut from = self.point(next.start).map_err(about)?;
        let mut passes = Vec::new();
        let mut has_moved = false;
        let mut ends = next.chord_ends(self.args.program.tolerance).peekable();
        while let Some(to) = ends.next() {
            let to = self.point(to).map_err(about)?;
            // Several chords may be shorter than a step of the lattice; a tool that stands still has cut where it stands.
            let stands = ends.peek().is_none() && !has_moved;
            if from != to || stands {
                let pass = self.pass(body, [from, to], next.line).map_err(about)?;
                passes.extend(pass);
                has_moved = true;
            }
            from = to;
        }
        Ok(passes)
    }

    /// The lattice point nearest to a place in mm.
    fn point(&self, place: [f64; 3]) -> Result<Point, String> {
        let user = place.map(|mm| mm / self.args.unit.mm());
        self.fineness
            .scale
            .point(user, "")
            .map_err(|fault| format!("the tool cannot be there: {fault}"))
    }

    /// A tool carried along a chord; none when nothing of it comes near the stock.
    fn pass(&mut self, body: &Body, ends: [Point; 2], line: u64) -> Result<Option<Pass>, String> {
        let flutes = match self.flutes(body, ends)? {
            Some((swept, ends)) if self.blank.is_near(swept, ends) => {
                let number = self.put_down.entry(line).or_default();
                let id = id(line, *number)?;
                *number += 1;
                let carried = Carried {
                    swept: Arc::clone(swept),
                    ends,
                };
                Some(Cut { id, carried })
            }
            _ => None,
        };
        let blunt = match &body.blunt {
            Some(blunt) if self.top.is_some() && self.blank.is_near(blunt, ends) => Some(Carried {
                swept: Arc::clone(blunt),
                ends,
            }),
            _ => None,
        };
        let is_near = flutes.is_some() || blunt.is_some();
        Ok(is_near.then_some(Pass { flutes, blunt }))
    }

    /// The form of the flutes that is right along a segment, and the part of the segment where they may cut.
    fn flutes<'body>(
        &self,
        body: &'body Body,
        ends: [Point; 2],
    ) -> Result<Option<Segment<'body>>, String> {
        let lowest = ends.map(|end| end.wide()[2]).into_iter().min();
        let lowest = lowest.expect("there are two");
        if let (Some(top), Some(raised)) = (self.blank.top(), &body.raised)
            && body
                .height
                .is_none_or(|height| lowest + height >= i64::from(top))
        {
            return Ok(below(ends, top).map(|ends| (raised, ends)));
        }
        let flutes = body
            .flutes
            .as_ref()
            .ok_or("its flutes are shorter than the tool must be here")?;
        Ok(Some((flutes, ends)))
    }

    /// How far what is put down is from what the program says.
    pub(super) fn rounding(&self) -> Rounding {
        let scale = self.fineness.scale;
        let deviation = self.deviation.max(self.blank.deviation);
        Rounding {
            outside: scale.deviation(deviation.outside),
            inside: scale.deviation(deviation.inside),
            chords: self.args.program.tolerance / self.args.unit.mm(),
            lattice: 0.5 / f64::from(scale.steps_per_unit()),
        }
    }
}

/// Up to where tools are raised: above the stock by the highest of their ends. Units: steps.
fn common_top(blank: &Blank, tools: &ToolTable, fineness: Fineness) -> Result<Option<i32>, String> {
    let Some(top) = blank.top() else {
        return Ok(None);
    };
    let shapes = tools.tools().filter_map(|(_, tool)| match &tool.shape {
        Shaped::Given(shape) | Shaped::Comment(shape, _) => Some(shape),
        Shaped::Unknown | Shaped::Unsupported(_) => None,
    });
    let heights = shapes.map(|shape| end_height(shape, fineness));
    let highest = i64::from(top).saturating_add(heights.max().unwrap_or(0));
    i32::try_from(highest)
        .map(Some)
        .map_err(|_| "a tool is too high for the lattice: take fewer --steps-per-unit".into())
}

/// `T1=`, or nothing for the tool of programs that name none.
fn numbered(number: u32) -> String {
    match number {
        0 => String::new(),
        _ => format!("T{number}="),
    }
}

/// The part of a segment that is not above a height; none when nothing of it is below. Where it crosses the height it is rounded to the lattice, the
/// same in both directions.
fn below(ends: [Point; 2], height: i32) -> Option<[Point; 2]> {
    let height = i64::from(height);
    let is_above = ends.map(|end| end.wide()[2] >= height);
    match is_above {
        [true, true] => None,
        [false, false] => Some(ends),
        [true, false] => Some([crossing(ends[1], ends[0], height), ends[1]]),
        [false, true] => Some([ends[0], crossing(ends[0], ends[1], height)]),
    }
}

/// Where the way up from one point to another crosses a height, rounded to the lattice (halves upwards).
fn crossing(lower: Point, upper: Point, height: i64) -> Point {
    let (from, to) = (lower.wide().map(i128::from), upper.wide().map(i128::from));
    let (part, whole) = (i128::from(height) - from[2], to[2] - from[2]);
    let at = [0, 1, 2].map(|axis| {
        let moved = (2 * (to[axis] - from[axis]) * part + whole).div_euclid(2 * whole);
        i64::try_from(from[axis] + moved).expect("it is between the two")
    });
    Point::new(at).expect("it is between two points")
}
