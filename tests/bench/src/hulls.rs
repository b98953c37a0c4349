//! `union3d-bench hulls`: a set of solids for other programs; and reading it.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use serde::{Deserialize, Serialize};
use union3d::engine::solids::{Body, Shape};
use union3d::geometry::convex::{Point, Solid};

use super::failure::{Failure, about};
use super::figures::parse_count;
use super::solid_sets::SolidSet;

/// Print a set of solids as hulls of points, for other programs
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Prints the solids of a set, a line each: {\"hull\":[[x,y,z],..]} with the vertices in lattice steps. `union3d-bench peers --solids` \
reads it, and so does `union3d measure --kind solids --steps-per-unit 1`."
)]
pub(crate) struct Args {
    /// How the solids lie.
    #[arg(long, value_enum)]
    set: SolidSet,
    /// How many.
    #[arg(long, value_name = "COUNT", default_value = "1k", value_parser = parse_count)]
    solids: usize,
    /// Where the random numbers begin.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A line.
#[derive(Serialize, Deserialize)]
struct Hull {
    hull: Vec<[i64; 3]>,
}

/// Runs `union3d-bench hulls`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut text = String::new();
    for body in args.set.bodies(args.solids, args.seed)? {
        let hull = Hull {
            hull: vertices(&body)?,
        };
        writeln!(text, "{}", serde_json::to_string(&hull)?)?;
    }
    std::io::stdout().write_all(text.as_bytes())?;
    Ok(())
}

/// The vertices of a body of one part.
fn vertices(body: &Body) -> Result<Vec<[i64; 3]>, Failure> {
    let carried;
    let solid = match (body.hull(), body.sweep()) {
        (Some(hull), _) => hull,
        (None, Some((shape, from, to))) => {
            carried = part(shape)?.swept(from, to)?;
            &carried
        }
        (None, None) => return Err("a body that is neither a hull nor a sweep".into()),
    };
    Ok(solid.vertices().iter().map(|point| point.wide()).collect())
}

fn part(shape: &Shape) -> Result<&Solid, Failure> {
    match shape.parts() {
        [part] => Ok(part),
        _ => Err("a shape of several parts is no hull".into()),
    }
}

/// The solids of a file, as `union3d-bench hulls` prints them.
/// # Errors
/// The file cannot be read, or a line is no solid.
pub(crate) fn read(path: &Path) -> Result<Vec<Body>, Failure> {
    let text = std::fs::read_to_string(path).map_err(about(path))?;
    let mut bodies = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let body = body(line).map_err(|error| format!("{}:{number}: {error}", path.display()))?;
        bodies.push(body);
    }
    Ok(bodies)
}

fn body(line: &str) -> Result<Body, Failure> {
    let Hull { hull } = serde_json::from_str(line)?;
    let points: Vec<Point> = hull.into_iter().map(Point::new).collect::<Result<_, _>>()?;
    Ok(Body::solid(Solid::hull(&points)?))
}
