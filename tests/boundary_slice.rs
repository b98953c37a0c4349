//! Slices: of boxes exactly those of voxels, of solids with the volume that the engine has, over each other without a gap.
//!
//! Small worlds with large bodies, so that ties are the common case. Every random test prints its seed when it fails.

#[path = "oracle/random.rs"]
mod random;

use std::ops::ControlFlow;

use random::Random;
use union3d::boundary::section::{Cut, GRID_BITS, GridPoint, Polygon};
use union3d::boundary::slice::Slice;
use union3d::boundary::{Region, solids};
use union3d::engine::Engine as CubeEngine;
use union3d::engine::solids::{Body, Effect, Engine, SolidId, Stock, VOLUME_UNIT};
use union3d::geometry::convex::{Point, Solid};
use union3d::geometry::{self, Bounds, CubeId, Edge, Place};

const GRID: i64 = 1 << GRID_BITS;

const REGIONS: [Region; 3] = [Region::Union, Region::Removed, Region::Remaining];

fn random_box(random: &mut Random, side: i64) -> Bounds {
    let (mut min, mut max) = ([0; 3], [0; 3]);
    for axis in 0..3 {
        let low = random.below(side);
        min[axis] = i32::try_from(low).unwrap();
        max[axis] = i32::try_from(low + 1 + random.below(side - low)).unwrap();
    }
    Bounds { min, max }
}

fn point(coordinates: [i64; 3]) -> Point {
    Point::new(coordinates).unwrap()
}

fn solid_of_box(bounds: &Bounds, steps: i64) -> Solid {
    let corner = |corner: [i32; 3]| point(corner.map(|at| steps * i64::from(at)));
    let [min, max] = [bounds.min, bounds.max].map(corner);
    Solid::cuboid(min, max).unwrap()
}

/// A hull of points with coordinates that are multiples of `steps`.
fn random_hull(random: &mut Random, side: i64, steps: i64) -> Solid {
    loop {
        let count = 4 + random.below(6);
        let mut corner = || point([(); 3].map(|()| steps * random.within(0, side)));
        let points: Vec<Point> = (0..count).map(|_| corner()).collect();
        if let Ok(hull) = Solid::hull(&points) {
            return hull;
        }
    }
}

/// The cells of a layer that boxes fill, `side + 2` a row, with one empty cell around.
fn pixels(cut: Cut, layer: i32, boxes: &[Bounds], side: i32) -> Vec<Vec<bool>> {
    let [u, v] = cut.across();
    let row = |y: i32| {
        let is_filled = |x: i32| {
            boxes.iter().any(|Bounds { min, max }| {
                (min[cut.axis]..max[cut.axis]).contains(&layer)
                    && (min[u]..max[u]).contains(&x)
                    && (min[v]..max[v]).contains(&y)
            })
        };
        (-1..=side).map(is_filled).collect()
    };
    (-1..=side).map(row).collect()
}

/// Area and perimeter of cells.
fn measured(cells: &[Vec<bool>]) -> (i128, i128) {
    let (mut area, mut perimeter) = (0, 0);
    for y in 1..cells.len() {
        for x in 1..cells.len() {
            area += i128::from(cells[y][x]);
            perimeter += i128::from(cells[y][x] != cells[y][x - 1]);
            perimeter += i128::from(cells[y][x] != cells[y - 1][x]);
        }
    }
    (area, perimeter)
}

/// Whether a ring goes around the middle of a cell: by the edges that a ray to the right crosses.
fn goes_around(ring: &[GridPoint], x: i64, y: i64) -> bool {
    let (x, y) = (x * GRID + GRID / 2, y * GRID + GRID / 2);
    let next = ring.iter().cycle().skip(1);
    let crossed = ring.iter().zip(next).filter(|(from, to)| {
        assert!(from.x == to.x || from.y == to.y, "an edge along an axis");
        (from.y > y) != (to.y > y) && from.x > x
    });
    crossed.count() % 2 == 1
}

fn doubled_area(ring: &[GridPoint]) -> i128 {
    let next = ring.iter().cycle().skip(1);
    ring.iter()
        .zip(next)
        .map(|(a, b)| i128::from(a.x) * i128::from(b.y) - i128::from(a.y) * i128::from(b.x))
        .sum()
}

#[track_caller]
fn check_directions(slice: &Slice) {
    for shape in &slice.shapes {
        assert!(doubled_area(&shape.outer) > 0, "an outline is clockwise");
        for hole in &shape.holes {
            assert!(doubled_area(hole) < 0, "a hole is counterclockwise");
        }
    }
}

fn of_boxes(cut: Cut, boxes: &[Bounds], stock: Option<&Bounds>, region: Region) -> Slice {
    let sections: Vec<Polygon> = boxes.iter().filter_map(|one| cut.of_box(one)).collect();
    let stock = stock.and_then(|stock| cut.of_box(stock));
    Slice::of(&sections, stock.as_ref(), region)
}

#[track_caller]
fn check_against_pixels(slice: &Slice, wanted: &[Vec<bool>], side: i32) {
    check_directions(slice);
    let (area, perimeter) = measured(wanted);
    assert_eq!(slice.area2(), (2 * area) << (2 * GRID_BITS));
    #[expect(clippy::cast_precision_loss, reason = "a few cells")]
    let (area, perimeter) = (area as f64, perimeter as f64);
    assert_eq!((slice.area(), slice.perimeter()), (area, perimeter));
    for y in -1..=side {
        for x in -1..=side {
            let around = slice
                .rings()
                .filter(|ring| goes_around(ring, x.into(), y.into()));
            let index = |at: i32| usize::try_from(at + 1).unwrap();
            let filled = wanted[index(y)][index(x)];
            assert_eq!(around.count() % 2 == 1, filled, "cell {x} {y}");
        }
    }
}

#[test]
fn slices_of_boxes_are_those_of_voxels() {
    let (mut with_holes, mut empty) = (0, 0);
    for seed in 1..=400 {
        let mut random = Random::new(seed);
        let side = i32::try_from(random.within(2, 7)).unwrap();
        let count = random.within(1, 9);
        let boxes: Vec<Bounds> = (0..count)
            .map(|_| random_box(&mut random, side.into()))
            .collect();
        let stock = match random.below(2) {
            0 => random_box(&mut random, side.into()),
            _ => Bounds {
                min: [0; 3],
                max: [side; 3],
            },
        };
        let axis = random.below(3);
        for layer in -1..=side {
            // At a face, and between two.
            let within = random.below(GRID) * i64::from(random.below(2) == 1);
            let at = i64::from(layer) * GRID + within;
            let cut = Cut { axis, at };
            let all = pixels(cut, layer, &boxes, side);
            let block = pixels(cut, layer, &[stock], side);
            for region in REGIONS {
                let slice = of_boxes(cut, &boxes, Some(&stock), region);
                let wanted: Vec<Vec<bool>> = all
                    .iter()
                    .zip(&block)
                    .map(|(row, of_stock)| {
                        let both = row.iter().zip(of_stock);
                        both.map(|(&is_filled, &is_stock)| match region {
                            Region::Union => is_filled,
                            Region::Removed => is_filled && is_stock,
                            Region::Remaining => !is_filled && is_stock,
                        })
                        .collect()
                    })
                    .collect();
                check_against_pixels(&slice, &wanted, side);
                with_holes += slice
                    .shapes
                    .iter()
                    .map(|shape| shape.holes.len())
                    .sum::<usize>();
                empty += usize::from(slice.shapes.is_empty());
            }
            assert!(
                of_boxes(cut, &boxes, None, Region::Removed)
                    .shapes
                    .is_empty()
            );
            // As solids they are cut the same.
            let sections: Vec<Polygon> = boxes
                .iter()
                .filter_map(|one| cut.of_solid(&solid_of_box(one, 1)))
                .collect();
            let of_solids = Slice::of(&sections, None, Region::Union);
            assert_eq!(of_solids, of_boxes(cut, &boxes, None, Region::Union));
        }
    }
    assert!(with_holes > 50 && empty > 200, "{with_holes} {empty}");
}

/// Between two lattice coordinates nothing changes, so that the slices of all layers make the volume, exactly.
#[test]
fn the_volume_of_cubes_is_the_sum_of_their_slices() {
    for seed in 1..=60 {
        let mut random = Random::new(seed);
        let steps = random.within(1, 4);
        let edge = Edge::new(steps).unwrap();
        let stock = geometry::Stock::new([1, 0, 2], [7, 9, 8]).unwrap();
        let mut engine = CubeEngine::new(edge).with_stock(Some(stock));
        let mut boxes = Vec::new();
        let mut effect = geometry::Effect::default();
        for id in 0..random.below(60_u64) {
            let corner = [(); 3].map(|()| random.within(-2, 8));
            let place = Place::new(corner, edge).unwrap();
            effect.inserted.push((CubeId(id), place));
            let max = place.corner().map(|low| low + edge.steps());
            boxes.push(Bounds {
                min: place.corner(),
                max,
            });
        }
        engine.apply(&effect).unwrap();
        let totals = engine.totals();
        let measures = totals.stock.as_ref().unwrap();
        for axis in 0..3 {
            let volume = |region| {
                let layers = (-3..14).map(|layer| {
                    let at = layer * GRID;
                    let cut = Cut { axis, at };
                    of_boxes(cut, &boxes, Some(&stock.bounds()), region).area2()
                });
                layers.sum::<i128>() >> (2 * GRID_BITS + 1)
            };
            assert_eq!(volume(Region::Union), totals.measures.volume);
            assert_eq!(volume(Region::Removed), measures.removed.volume);
            assert_eq!(volume(Region::Remaining), measures.remaining.volume);
        }
    }
}

fn slice_of(cut: Cut, bodies: &[Body], stock: Option<&Stock>, region: Region) -> Slice {
    let parts = bodies
        .iter()
        .flat_map(|body| (0..body.len()).map(|part| body.part(part)));
    let sections: Vec<Polygon> = parts.filter_map(|part| cut.of_solid(&part)).collect();
    let stock = stock.and_then(|stock| cut.of_solid(stock.solid()));
    Slice::of(&sections, stock.as_ref(), region)
}

/// The area of a slice of solids is a quadratic of the height between two vertices of the union, so that Gauss's rule of two points is exact
/// there.
#[test]
fn the_volume_of_solids_is_the_integral_of_their_slices() {
    // So large that the engine's volume, which is rounded for each flag, is right to ten digits.
    const STEPS: i64 = 4_096;
    let mut compared = 0;
    for seed in 1..=150 {
        let mut random = Random::new(seed);
        let side = random.within(2, 6);
        let count = random.within(1, 7);
        let mut effect = Effect::default();
        for id in 0..count.unsigned_abs() {
            let solid = match random.below(3) {
                0 => solid_of_box(&random_box(&mut random, side), STEPS),
                _ => random_hull(&mut random, side, STEPS),
            };
            effect.inserted.push((SolidId(id), Body::solid(solid)));
        }
        let stock = match random.below(3) {
            0 => random_hull(&mut random, side, STEPS),
            _ => solid_of_box(&random_box(&mut random, side), STEPS),
        };
        let stock = (random.below(2) == 0).then(|| Stock::new(stock).unwrap());
        let mut engine = Engine::new().with_stock(stock.clone());
        engine.apply(&effect).unwrap();
        let totals = engine.totals();
        let bodies: Vec<Body> = effect
            .inserted
            .iter()
            .map(|(_, body)| body.clone())
            .collect();
        let regions = match stock {
            // With a stock the engine has the measures of what is removed in the place of the union's.
            Some(_) => vec![Region::Removed, Region::Remaining],
            None => vec![Region::Union],
        };
        for region in regions {
            let measures = match region {
                Region::Remaining => totals.remaining.unwrap(),
                _ => totals.measures,
            };
            #[expect(clippy::cast_precision_loss, reason = "a small volume")]
            let volume = measures.volume6 as f64 * 2_f64.powi(VOLUME_UNIT) / 6.0;
            for axis in 0..3 {
                let mut heights = vec![];
                let listed = effect.inserted.iter().cloned();
                let stock = stock.as_ref();
                let end = solids::faces(listed, stock, region, None, &|| true, &mut |face| {
                    heights.extend(face.edges.iter().map(|[from, _]| from[axis]));
                    ControlFlow::Continue(())
                });
                assert!(end.unwrap().is_continue());
                heights.sort_by(f64::total_cmp);
                heights.dedup();
                let mut sum = 0.0;
                for pair in heights.windows(2) {
                    let (middle, half) =
                        (f64::midpoint(pair[0], pair[1]), (pair[1] - pair[0]) / 2.0);
                    for side in [-1.0, 1.0] {
                        let height = middle + side * half / 3_f64.sqrt();
                        #[expect(clippy::cast_possible_truncation, reason = "a small height")]
                        let at = (height * 2_f64.powi(30)).round() as i64;
                        let slice = slice_of(Cut { axis, at }, &bodies, stock, region);
                        check_directions(&slice);
                        sum += half * slice.area();
                    }
                }
                let error = (sum - volume).abs();
                assert!(error <= 1e-7 * volume.max(1.0), "{sum} is not {volume}");
                compared += 1;
            }
        }
    }
    assert!(compared > 500, "{compared}");
}

/// At a face a slice is the limit from above: the bottom of a body is its slice there, and at its top it has none.
#[test]
fn a_slice_at_a_face_is_what_is_above_it() {
    let pyramid = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]].map(point);
    let up = Solid::hull(&pyramid).unwrap();
    let down = Solid::hull(&pyramid.map(|at| {
        let [x, y, z] = at.wide();
        point([x, y, -z])
    }))
    .unwrap();
    let area = |solid: &Solid, at: i64| {
        let cut = Cut { axis: 2, at };
        let sections: Vec<Polygon> = cut.of_solid(solid).into_iter().collect();
        Slice::of(&sections, None, Region::Union).area()
    };
    assert_eq!(area(&up, -1), 0.0);
    assert_eq!(area(&up, 0), 8.0);
    assert_eq!(area(&up, 2 * GRID), 2.0);
    assert_eq!(area(&up, 4 * GRID), 0.0);
    assert_eq!(area(&down, -4 * GRID), 0.0);
    assert_eq!(area(&down, -2 * GRID), 2.0);
    assert_eq!(area(&down, 0), 0.0);
    let nearly = area(&down, -1);
    assert!((nearly - 8.0).abs() < 1e-7, "{nearly}");
}

/// Far out, and as large as can be.
#[test]
fn slices_are_exact_at_the_ends_of_the_range() {
    let far = geometry::COORDINATE_MAX;
    let all = Bounds {
        min: [-far; 3],
        max: [far; 3],
    };
    let hole = Bounds {
        min: [far - 3, -far + 1, -far],
        max: [far - 1, far - 1, far],
    };
    let cut = Cut { axis: 2, at: 0 };
    let slice = of_boxes(cut, &[hole], Some(&all), Region::Remaining);
    let (side, far) = (2 * i128::from(far), i128::from(far));
    assert_eq!(
        slice.area2(),
        (side * side - 2 * (2 * far - 2)) << (2 * GRID_BITS + 1)
    );
    assert_eq!(slice.shapes.len(), 1);
    assert_eq!(slice.shapes[0].holes.len(), 1);
}

#[test]
fn what_lies_over_each_other_is_shared_out() {
    for seed in 1..=200 {
        let mut random = Random::new(seed);
        let side = random.within(2, 7);
        let mut boxes = || -> Vec<Bounds> {
            let count = random.below(8);
            (0..count).map(|_| random_box(&mut random, side)).collect()
        };
        let (first, second) = (boxes(), boxes());
        let layer = i32::try_from(random.below(side)).unwrap();
        let cut = Cut {
            axis: random.below(3),
            at: i64::from(layer) * GRID,
        };
        let side = i32::try_from(side).unwrap();
        let slice = |boxes: &[Bounds]| of_boxes(cut, boxes, None, Region::Union);
        let overlaid = slice(&first).over(&slice(&second));
        let cells = [&first, &second].map(|boxes| pixels(cut, layer, boxes, side));
        let wanted = |in_first: bool, in_second: bool| -> Vec<Vec<bool>> {
            let rows = cells[0].iter().zip(&cells[1]);
            let cell = |(&a, &b): (&bool, &bool)| a == in_first && b == in_second;
            rows.map(|(a, b)| a.iter().zip(b).map(cell).collect())
                .collect()
        };
        check_against_pixels(&overlaid.first, &wanted(true, false), side);
        check_against_pixels(&overlaid.second, &wanted(false, true), side);
        check_against_pixels(&overlaid.both, &wanted(true, true), side);
        // In a scale three times as fine.
        let finer = slice(&first).scaled(3, 1).unwrap();
        assert_eq!(finer.area2(), 9 * slice(&first).area2());
        assert_eq!(finer.scaled(1, 3).unwrap(), slice(&first));
        let again = finer.over(&slice(&second).scaled(3, 1).unwrap());
        assert_eq!(again.both.area2(), 9 * overlaid.both.area2());
    }
}

/// Two solids that share an oblique facet in different pieces have no crack between them.
#[test]
fn there_is_no_crack_along_a_shared_facet() {
    let hull = |points: &[[i64; 3]]| {
        let points: Vec<Point> = points.iter().map(|&at| point(at)).collect();
        Solid::hull(&points).unwrap()
    };
    let whole = hull(&[[0, 0, 0], [7, 0, 0], [0, 11, 0], [0, 0, 13]]);
    let bodies = [
        Body::solid(hull(&[
            [0, 0, 0],
            [7, 0, 0],
            [0, 0, 13],
            [1, 3, 0],
            [0, 11, 0],
        ])),
        Body::solid(hull(&[[7, 0, 0], [0, 11, 0], [0, 0, 13], [9, 9, 9]])),
    ];
    for at in 0..200 {
        let cut = Cut {
            axis: 2,
            at: at * GRID * 13 / 200 + 12345,
        };
        let slice = slice_of(cut, &bodies, None, Region::Union);
        assert_eq!(slice.shapes.len(), 1);
        assert!(slice.shapes[0].holes.is_empty());
        assert!(cut.of_solid(&whole).is_some());
    }
}
