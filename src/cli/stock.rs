//! The stock as it is written on the command line, or in comments of the program.

use union3d::toolpath::{StockComment, Warning};
use union3d::wire::solids::{CutterDocument, FitName, ReadStock, Scale, SolidStockDocument};

use super::cutter::{Unit, positive};
use super::program::point;

/// Sides of the polygon that stands for a round stock.
const SIDES: u16 = 128;

/// The material before anything is cut. Units: the scene's.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum StockForm {
    /// From its least to its greatest corner.
    Box([[f64; 3]; 2]),
    /// Upright, on the middle of its lower end.
    Cylinder {
        base: [f64; 3],
        diameter: f64,
        height: f64,
    },
    /// The convex hull of points.
    Hull(Vec<[f64; 3]>),
    /// None, whatever comments of the program say.
    Nothing,
}

/// A stock, such as `0,0,-10:80,60,0`, `cylinder:0,0,-20:50x20`, `hull:0,0,0:10,0,0:0,10,0:0,0,10` or `none`.
pub(crate) fn parse(text: &str) -> Result<StockForm, String> {
    if text == "none" {
        return Ok(StockForm::Nothing);
    }
    if let Some(cylinder) = text.strip_prefix("cylinder:") {
        let parsed = cylinder.split_once(':').and_then(|(base, size)| {
            let (diameter, height) = size.split_once('x')?;
            Some(StockForm::Cylinder {
                base: point(base).ok()?,
                diameter: positive(diameter).ok()?,
                height: positive(height).ok()?,
            })
        });
        return parsed.ok_or_else(|| {
            "it is no middle of the lower end, diameter and height, such as cylinder:0,0,-20:50x20"
                .to_owned()
        });
    }
    if let Some(points) = text.strip_prefix("hull:") {
        let points: Result<Vec<_>, _> = points.split(':').map(point).collect();
        return points.map(StockForm::Hull);
    }
    text.split_once(':')
        .and_then(|(min, max)| Some(StockForm::Box([point(min).ok()?, point(max).ok()?])))
        .ok_or_else(|| "it is not two corners, such as 0,0,-10:80,60,0".to_owned())
}

/// What comments of a program say of its stock, in the scene's unit, and what is to be told of that.
pub(crate) fn from_comment(said: StockComment, unit: Unit) -> (Option<StockForm>, Option<Warning>) {
    let told = |line: u64, text: String| Warning {
        line,
        code: "stock-comment".into(),
        text,
    };
    match said {
        StockComment::Nothing => (None, None),
        StockComment::Box { corners, line } => {
            // 1.5 inches are 38.1 mm, not a bit less.
            let user = |mm: f64| (mm / unit.mm() * 1e6).round() / 1e6;
            let corners = corners.map(|corner| corner.map(user));
            let [least, greatest] = corners.map(|[x, y, z]| format!("{x:?},{y:?},{z:?}"));
            let text = format!("the stock is taken from this comment: --stock {least}:{greatest}");
            (Some(StockForm::Box(corners)), Some(told(line, text)))
        }
        StockComment::Unclear { line, why } => {
            let text = format!("{why}: no stock is taken from it; give --stock");
            (None, Some(told(line, text)))
        }
    }
}

impl StockForm {
    /// The corners of a box.
    ///
    /// # Errors
    /// A sentence when it is none: square cutters cut boxes only.
    pub(crate) fn corners(&self) -> Result<[[f64; 3]; 2], String> {
        match self {
            Self::Box(corners) => Ok(*corners),
            _ => Err("--stock: cubes cut a box only, MIN:MAX".into()),
        }
    }

    /// The convex solid that it is.
    ///
    /// # Errors
    /// A sentence says what is wrong with it.
    pub(crate) fn read(&self, scale: Scale) -> Result<ReadStock, String> {
        let read = self.document(scale).read(scale);
        read.map_err(|fault| format!("--stock: {fault}"))
    }

    /// As scenes of solids know it.
    fn document(&self, scale: Scale) -> SolidStockDocument {
        let per_unit = f64::from(scale.steps_per_unit());
        let steps = |length: f64| (length * per_unit).round() / per_unit;
        match self {
            Self::Box([min, max]) => SolidStockDocument::cuboid(*min, *max),
            Self::Cylinder {
                base,
                diameter,
                height,
            } => SolidStockDocument {
                cylinder: Some(CutterDocument {
                    diameter: steps(*diameter),
                    length: steps(*height),
                    corner_radius: None,
                    tip: None,
                    angle: None,
                    rings: None,
                    sides: SIDES,
                    polygon: FitName::EqualArea,
                    at: *base,
                }),
                ..SolidStockDocument::default()
            },
            Self::Hull(points) => SolidStockDocument {
                hull: Some(points.clone()),
                ..SolidStockDocument::default()
            },
            Self::Nothing => unreachable!("no stock has no form"),
        }
    }
}
