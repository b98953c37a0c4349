//! The stock as it is written on the command line.

use super::super::program::point;

/// The material before anything is cut. Units: the scene's.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum StockForm {
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
}

/// A stock, such as `0,0,-10:80,60,0`, `cylinder:0,0,-20:50x20` or `hull:0,0,0:10,0,0:0,10,0:0,0,10`.
pub(super) fn parse(text: &str) -> Result<StockForm, String> {
    if let Some(cylinder) = text.strip_prefix("cylinder:") {
        let parsed = cylinder.split_once(':').and_then(|(base, size)| {
            let (diameter, height) = size.split_once('x')?;
            Some(StockForm::Cylinder {
                base: point(base).ok()?,
                diameter: super::cutter::positive(diameter).ok()?,
                height: super::cutter::positive(height).ok()?,
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

impl StockForm {
    /// The corners of a box.
    ///
    /// # Errors
    /// A sentence when it is none: square cutters cut boxes only.
    pub(super) fn corners(&self) -> Result<[[f64; 3]; 2], String> {
        match self {
            Self::Box(corners) => Ok(*corners),
            _ => Err("--stock: square cutters (--edge) cut a box only, MIN:MAX".into()),
        }
    }
}
