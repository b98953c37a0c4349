//! Scenes of solids: each call, and that HTTP sees the same.

use std::collections::HashMap;

use prost::Message;
use serde_json::{Value, json};
use tokio_stream::StreamExt;
use tonic::{Code, Status};
use union3d::service::ServiceConfig;
use union3d::wire::http::Limits;
use union3d::wire::proto::shape::Form;
use union3d::wire::proto::solid_scene_settings::StockForm;
use union3d::wire::proto::{
    Acknowledged, ApplyChangeRequest, AuditSceneRequest, Box as Block, Change, ContainsRequest,
    CreateSceneRequest, CreateSceneResponse, Cutter, DefineShapeRequest, ExactSolids, FixedPoint,
    GetCubeRequest, GetHistoryRequest, GetMassPropertiesRequest, GetSceneRequest, GetSolidRequest,
    Hull, ListSolidsRequest, OnRefusal, Outcome, Points, Polygon, RevertSceneRequest,
    SceneSettings, Shape, Shapes, Side, SolidMassProperties, SolidMeasures, SolidSceneSettings,
    Vector, WatchMassPropertiesRequest,
};

use crate::server::{NONE, Server, VOLUME, deletion, refused, row};
use crate::streams::{acknowledged, opened, opening, stream, tagged};

fn vector([x, y, z]: [f64; 3]) -> Option<Vector> {
    Some(Vector { x, y, z })
}

fn shape(form: Form) -> Shape {
    Shape {
        form: Some(form),
        top: None,
    }
}

fn cuboid(size: [f64; 3]) -> Shape {
    shape(Form::Box(Block {
        min: vector([0.0; 3]),
        max: vector(size),
    }))
}

fn cutter(diameter: f64) -> Cutter {
    Cutter {
        diameter,
        length: 20.0,
        sides: Some(8),
        polygon: Polygon::Inscribed.into(),
        ..Cutter::default()
    }
}

/// A block of 40 x 40 x 10 under the plane z = 0, ten steps a unit, a box, a flat that always reaches up to 30, and a ball.
fn settings() -> SolidSceneSettings {
    SolidSceneSettings {
        steps_per_unit: Some(10),
        stock_form: Some(StockForm::Stock(Block {
            min: vector([0.0, 0.0, -10.0]),
            max: vector([40.0, 40.0, 0.0]),
        })),
        shapes: HashMap::from([
            ("b".to_owned(), cuboid([2.0, 3.0, 4.0])),
            (
                "t1".to_owned(),
                Shape {
                    top: Some(30.0),
                    ..shape(Form::Flat(cutter(6.0)))
                },
            ),
            ("t2".to_owned(), shape(Form::Ball(cutter(4.0)))),
        ]),
        ..SolidSceneSettings::default()
    }
}

/// The same over HTTP.
fn settings_json() -> Value {
    let cutter = |diameter: f64| json!({"diameter": diameter, "length": 20, "sides": 8, "polygon": "inscribed"});
    json!({
        "kind": "solids", "steps_per_unit": 10,
        "stock": {"min": [0, 0, -10], "max": [40, 40, 0]},
        "shapes": {"b": {"box": {"min": [0, 0, 0], "max": [2, 3, 4]}}, "t1": {"flat": cutter(6.0), "top": 30}, "t2": {"ball": cutter(4.0)}},
    })
}

async fn create(
    server: &Server,
    name: &str,
    solids: SolidSceneSettings,
) -> Result<CreateSceneResponse, Status> {
    let request = CreateSceneRequest {
        scene: name.to_owned(),
        settings: None,
        solids: Some(solids),
    };
    let created = server.client().create_scene(request).await?;
    Ok(created.into_inner())
}

async fn totals(server: &Server, scene: &str) -> SolidMassProperties {
    let request = GetMassPropertiesRequest {
        scene: scene.to_owned(),
        ..GetMassPropertiesRequest::default()
    };
    let answer = server.client().get_mass_properties(request).await.unwrap();
    let answer = answer.into_inner();
    assert!(answer.mass_properties.is_none());
    answer.solid_mass_properties.unwrap()
}

/// A slot of the flat, one of the ball and a hull in the block, and a box that stands in it.
fn part() -> Change {
    Change {
        insert_id: vec![1, 2, 3, 9],
        shapes: ["t1", "t2", "b"].map(str::to_owned).to_vec(),
        shape: vec![0, 1, 2],
        x: vec![50, 50, 300],
        y: vec![100, 200, 300],
        z: vec![-20, -30, -40],
        to_x: vec![350, 300, 300],
        to_y: vec![120, 200, 300],
        to_z: vec![-20, -50, -40],
        hulls: vec![Hull {
            x: vec![0, 100, 0, 0],
            y: vec![0, 0, 100, 0],
            z: vec![-100, -100, -100, 0],
        }],
        r#move: Some(7),
        duration: Some(0.5),
        ..Change::default()
    }
}

/// The same over HTTP.
fn part_json() -> Value {
    json!({"insert": [
        {"id": 1, "shape": "t1", "from": [5, 10, -2], "to": [35, 12, -2]},
        {"id": 2, "shape": "t2", "from": [5, 20, -3], "to": [30, 20, -5]},
        {"id": 3, "shape": "b", "at": [30, 30, -4]},
        {"id": 9, "hull": [[0, 0, -10], [10, 0, -10], [0, 10, -10], [0, 0, 0]]},
    ], "move": 7, "duration": 0.5})
}

/// The same mass properties as HTTP has them.
fn as_json(shown: &SolidMassProperties) -> Value {
    let point = |point: &Option<Vector>| point.as_ref().map(|at| json!([at.x, at.y, at.z]));
    let mut json = measures(shown.measures.as_ref().unwrap());
    let removed = json.clone();
    let members = json.as_object_mut().unwrap();
    members.insert("scene".to_owned(), json!(shown.scene));
    members.insert("seq".to_owned(), json!(shown.seq));
    members.insert("solids".to_owned(), json!(shown.solids));
    let bounds = shown
        .bounds
        .as_ref()
        .map(|of| json!({"min": point(&of.min), "max": point(&of.max)}));
    members.insert("bounds".to_owned(), json!(bounds));
    if let Some(remaining) = &shown.remaining {
        members.insert("removed".to_owned(), removed);
        members.insert("remaining".to_owned(), measures(remaining));
    }
    json
}

fn measures(shown: &SolidMeasures) -> Value {
    let edges = shown.edge_length.unwrap();
    let tensor = shown.inertia.unwrap();
    let error = shown.error_max.unwrap();
    let centroid = shown.centroid.map(|at| json!([at.x, at.y, at.z]));
    json!({
        "volume": shown.volume, "area": shown.area,
        "edge_length": {"total": edges.total, "convex": edges.convex, "concave": edges.concave, "crossing": edges.crossing},
        "mass": shown.mass, "centroid": centroid,
        "inertia": [[tensor.xx, tensor.xy, tensor.zx], [tensor.xy, tensor.yy, tensor.yz], [tensor.zx, tensor.yz, tensor.zz]],
        "error_max": {"volume": error.volume, "area": error.area, "edge_length": error.edge_length,
            "centroid": error.centroid, "inertia": error.inertia},
        "exact": exact(shown.exact.as_ref().unwrap()),
    })
}

fn exact(exact: &ExactSolids) -> Value {
    let fixed = |of: &Option<FixedPoint>, one: bool| {
        let FixedPoint {
            values,
            divisor,
            error_max,
        } = of.clone().unwrap();
        let value = if one { json!(values[0]) } else { json!(values) };
        json!({"value": value, "divisor": divisor, "error_max": error_max})
    };
    json!({
        "steps_per_unit": exact.steps_per_unit,
        "volume": fixed(&exact.volume, true), "area": fixed(&exact.area, true),
        "edge_length": fixed(&exact.edge_length, false),
        "first_moments": fixed(&exact.first_moments, false),
        "second_moments": fixed(&exact.second_moments, false),
    })
}

/// The same scene and the same change, once over each protocol, and each is read over the other.
#[tokio::test]
async fn both_protocols_say_the_same() {
    let server = Server::start().await;
    let created = create(&server, "grpc", settings()).await.unwrap();
    assert!(created.created);
    assert!(!create(&server, "grpc", settings()).await.unwrap().created);
    let put = reqwest::Client::new()
        .put(format!("{}/v1/scenes/http", server.http))
        .json(&settings_json());
    assert_eq!(put.send().await.unwrap().status(), 201);

    let outcome = server.change("grpc", part()).await.unwrap();
    assert_eq!((outcome.seq, outcome.inserted), (1, 4));
    let (status, answer) = server.post("/v1/scenes/http/changes", &part_json()).await;
    assert_eq!(status, 200, "{answer}");
    assert_eq!(outcome.volume_removed_exact, answer["volume_removed_exact"]);
    assert_eq!(outcome.volume_removed, answer["volume_removed"]);

    for scene in ["grpc", "http"] {
        let shown = totals(&server, scene).await;
        let (_, over_http) = server
            .get(&format!("/v1/scenes/{scene}/mass-properties"))
            .await;
        assert_eq!(as_json(&shown), over_http);
    }
    let [one, other] = [totals(&server, "grpc").await, totals(&server, "http").await];
    assert_eq!(one.measures, other.measures);
    assert_eq!(one.remaining, other.remaining);
    let [removed, remaining] = [one.measures.unwrap().volume, one.remaining.unwrap().volume];
    assert_eq!(removed + remaining, 16_000.0);

    // The settings come back as they can be sent again, and say how far the polygons are from circles.
    for scene in ["grpc", "http"] {
        let request = GetSceneRequest {
            scene: scene.to_owned(),
        };
        let shown = server.client().get_scene(request).await.unwrap();
        let shown = shown.into_inner().scene.unwrap();
        assert_eq!(
            (shown.solids, shown.cubes, shown.settings),
            (Some(4), None, None)
        );
        let settings = shown.solid_settings.unwrap();
        assert_eq!(settings.polygon_error.len(), 2);
        assert!(settings.polygon_error["t1"].inside > 0.2);
        assert!(!create(&server, scene, settings).await.unwrap().created);
    }

    // As a body of HTTP the message is the same change.
    let message = part().encode_to_vec();
    let posted = reqwest::Client::new()
        .post(format!("{}/v1/scenes/http/changes", server.http))
        .header("content-type", "application/x-protobuf")
        .body(message);
    let answer: Value = posted.send().await.unwrap().json().await.unwrap();
    assert_eq!(
        (&answer["seq"], &answer["unchanged"]),
        (&json!(1), &json!(4))
    );
}

/// Any convex stock, over both protocols and after a restart: the same measures.
#[tokio::test]
async fn any_convex_stock_is_cut() {
    let server = Server::start().await;
    let points = [
        [0.0, 0.0, -10.0],
        [40.0, 0.0, -10.0],
        [0.0, 40.0, -10.0],
        [0.0, 0.0, 0.0],
        [20.0, 20.0, 0.0],
    ];
    let hull = Points {
        points: points.map(|point| vector(point).unwrap()).to_vec(),
    };
    let bar = Cutter {
        at: vector([20.0, 20.0, -10.0]),
        ..cutter(30.0)
    };
    let forms = [
        (StockForm::StockHull(hull), json!({ "hull": points })),
        (
            StockForm::StockCylinder(bar),
            json!({"cylinder": {"diameter": 30, "length": 20, "sides": 8, "polygon": "inscribed", "at": [20, 20, -10]}}),
        ),
    ];
    let mut measured = Vec::new();
    for (index, (form, document)) in forms.into_iter().enumerate() {
        let [grpc, http] = ["grpc", "http"].map(|name| format!("{name}{index}"));
        let stock = SolidSceneSettings {
            stock_form: Some(form.clone()),
            ..settings()
        };
        assert!(create(&server, &grpc, stock).await.unwrap().created);
        let mut settings = settings_json();
        settings["stock"] = document;
        let url = format!("{}/v1/scenes/{http}", server.http);
        let put = reqwest::Client::new().put(url).json(&settings);
        assert_eq!(put.send().await.unwrap().status(), 201);
        server.change(&grpc, part()).await.unwrap();
        let (status, answer) = server
            .post(&format!("/v1/scenes/{http}/changes"), &part_json())
            .await;
        assert_eq!(status, 200, "{answer}");
        let [one, other] = [totals(&server, &grpc).await, totals(&server, &http).await];
        assert_eq!(one.measures, other.measures);
        assert_eq!(one.remaining, other.remaining);
        for scene in [grpc, http] {
            let request = GetSceneRequest {
                scene: scene.clone(),
            };
            let shown = server.client().get_scene(request).await.unwrap();
            let shown = shown.into_inner().scene.unwrap().solid_settings.unwrap();
            assert_eq!(shown.stock_form, Some(form.clone()));
            assert_eq!(shown.stock_polygon_error.is_some(), index == 1);
            assert!(!create(&server, &scene, shown).await.unwrap().created);
            measured.push((scene.clone(), totals(&server, &scene).await));
        }
    }
    assert_ne!(measured[0].1.measures, measured[2].1.measures);
    let data = server.stop().await;
    let config = ServiceConfig::new(data.path());
    let server = Server::on(data, Limits::default(), config, None, true).await;
    for (scene, before) in measured {
        assert_eq!(totals(&server, &scene).await, before);
    }
    let flat = SolidSceneSettings {
        stock_form: Some(StockForm::StockHull(Points {
            points: vec![Vector::default(); 4],
        })),
        ..SolidSceneSettings::default()
    };
    let status = create(&server, "flat", flat).await.unwrap_err();
    assert_eq!(
        refused(&status, Code::InvalidArgument, "invalid"),
        ["solids.stock.hull"]
    );
}

/// A history of changes, from the first to the revert.
#[tokio::test]
async fn solids_are_measured_listed_and_reverted() {
    let server = Server::start().await;
    create(&server, "part", settings()).await.unwrap();
    let mut watch = {
        let request = WatchMassPropertiesRequest {
            scene: "part".to_owned(),
        };
        server
            .client()
            .watch_mass_properties(request)
            .await
            .unwrap()
            .into_inner()
    };
    let seen = watch.next().await.unwrap().unwrap().solid_mass_properties;
    assert_eq!(seen.unwrap().solids, 0);
    server.change("part", part()).await.unwrap();
    let after_first = totals(&server, "part").await;
    let seen = watch.next().await.unwrap().unwrap().solid_mass_properties;
    assert_eq!(seen.unwrap(), after_first);
    let gone = server
        .change("part", deletion([1, 9].into_iter()))
        .await
        .unwrap();
    assert_eq!((gone.seq, gone.deleted), (2, 2));
    assert!(gone.volume_removed < 0.0);

    let request = GetSolidRequest {
        scene: "part".to_owned(),
        id: 2,
    };
    let solid = server
        .client()
        .get_solid(request)
        .await
        .unwrap()
        .into_inner()
        .solid
        .unwrap();
    assert_eq!(solid.shape.as_deref(), Some("t2"));
    assert_eq!(
        (solid.from, solid.to),
        (vector([5.0, 20.0, -3.0]), vector([30.0, 20.0, -5.0]))
    );
    let request = GetSolidRequest {
        scene: "part".to_owned(),
        id: 1,
    };
    let none = server.client().get_solid(request).await.unwrap_err();
    refused(&none, Code::NotFound, "no-such-cube");

    let request = RevertSceneRequest {
        scene: "part".to_owned(),
        to: 1,
        detail: VOLUME,
        ..RevertSceneRequest::default()
    };
    let back = server
        .client()
        .revert_scene(request)
        .await
        .unwrap()
        .into_inner()
        .outcome
        .unwrap();
    assert_eq!(back.seq, 3);
    let first = after_first.measures.as_ref().unwrap();
    let volumes = back.volumes.unwrap();
    assert_eq!(
        (volumes.union, volumes.removed, volumes.area),
        (first.volume, Some(first.volume), first.area)
    );
    assert_eq!(
        volumes.remaining,
        Some(after_first.remaining.as_ref().unwrap().volume)
    );
    assert_eq!(
        volumes.exact_union,
        first
            .exact
            .as_ref()
            .unwrap()
            .volume
            .as_ref()
            .unwrap()
            .values[0]
    );

    // What is listed is a change that makes the same set.
    let request = ListSolidsRequest {
        scene: "part".to_owned(),
    };
    let mut listed = server
        .client()
        .list_solids(request)
        .await
        .unwrap()
        .into_inner();
    create(&server, "copy", settings()).await.unwrap();
    let mut count = 0;
    while let Some(some) = listed.next().await {
        let some = some.unwrap();
        assert_eq!(some.seq, 3);
        let outcome = server.change("copy", some.solids.unwrap()).await.unwrap();
        count += outcome.inserted;
    }
    assert_eq!(count, 4);
    let copy = totals(&server, "copy").await;
    let exact = |shown: &SolidMassProperties| {
        shown
            .measures
            .as_ref()
            .unwrap()
            .exact
            .as_ref()
            .unwrap()
            .volume
            .clone()
            .unwrap()
            .values
    };
    assert_eq!(exact(&copy), exact(&after_first));

    let request = GetHistoryRequest {
        scene: "part".to_owned(),
        ..GetHistoryRequest::default()
    };
    let rows = server
        .client()
        .get_history(request)
        .await
        .unwrap()
        .into_inner();
    let rows: Vec<_> = rows.map(Result::unwrap).collect().await;
    assert_eq!(rows.len(), 3);
    assert_eq!((rows[0].r#move, rows[0].duration), (Some(7), Some(0.5)));
    assert_eq!(rows[0].removal_rate, Some(rows[0].volume_removed * 2.0));
    assert_eq!(rows[0].solid_mass_properties, Some(after_first));
    assert_eq!(rows[1].volume_removed, -rows[2].volume_removed);

    let request = AuditSceneRequest {
        scene: "part".to_owned(),
    };
    let audit = server
        .client()
        .audit_scene(request)
        .await
        .unwrap()
        .into_inner();
    assert_eq!((audit.seq, audit.cubes), (3, 4));
}

/// Sweeps one after the other in a stream, the server numbering them.
#[tokio::test]
async fn sweeps_stream() {
    let server = Server::start().await;
    create(&server, "part", settings()).await.unwrap();
    let sweep = |index: i32| Change {
        shapes: vec!["t1".to_owned()],
        x: vec![10 * index],
        y: vec![100],
        z: vec![-20],
        to_x: vec![10 * index + 10],
        to_y: vec![100],
        to_z: vec![-20],
        ..Change::default()
    };
    let first = opening("part", OnRefusal::Stop, VOLUME);
    let changes = (0..20).map(|index| tagged(index as u64, sweep(index)));
    let messages = tokio_stream::iter(std::iter::once(first).chain(changes.collect::<Vec<_>>()));
    let mut answers = stream(&mut server.client(), messages).await;
    assert_eq!(opened(&mut answers).await.scene.unwrap().solids, Some(0));
    for index in 0..20 {
        let Acknowledged { tag, outcome } = acknowledged(&mut answers).await;
        let outcome = outcome.unwrap();
        assert_eq!((tag, outcome.seq), (index, index + 1));
        assert_eq!(outcome.assigned.unwrap().first, index + 1);
        assert!(
            outcome.volume_removed > 0.0,
            "each goes on where the last one stopped"
        );
    }
    // A shape that stays is a column less.
    let there = Change {
        shapes: vec!["b".to_owned()],
        x: vec![0],
        y: vec![0],
        z: vec![-40],
        ..Change::default()
    };
    let outcome = server.change("part", there).await.unwrap();
    assert_eq!(outcome.volume_removed, 24.0);
}

/// What a change would do, and where points lie.
#[tokio::test]
async fn dry_runs_and_points() {
    let server = Server::start().await;
    create(&server, "part", settings()).await.unwrap();
    server.scene("cubes", 6).await;
    for (scene, change) in [("part", part()), ("cubes", row(1..2))] {
        let request = |dry_run, key: Option<&str>| ApplyChangeRequest {
            scene: scene.to_owned(),
            change: Some(change.clone()),
            dry_run,
            idempotency_key: key.map(str::to_owned),
            ..ApplyChangeRequest::default()
        };
        let mut client = server.client();
        let dry = client.apply_change(request(true, None)).await.unwrap();
        let mut dry = dry.into_inner().outcome.unwrap();
        assert_eq!(dry.seq, 0);
        let keyed = client.apply_change(request(true, Some("k"))).await;
        let places = refused(&keyed.unwrap_err(), Code::InvalidArgument, "invalid");
        assert_eq!(places, ["idempotency_key"]);
        let real = client.apply_change(request(false, None)).await.unwrap();
        let real = real.into_inner().outcome.unwrap();
        assert_eq!(real.seq, 1);
        // All but the seq and, of solids, how far rounding can be off, which goes with history.
        dry.seq = 1;
        dry.mass_properties
            .iter_mut()
            .for_each(|shown| shown.seq = 1);
        assert_eq!(dry.mass_properties, real.mass_properties);
        assert_eq!(dry.volume_removed_exact, real.volume_removed_exact);
        let volume = |outcome: &Outcome| {
            let solids = outcome.solid_mass_properties.as_ref();
            solids.map(|shown| (shown.solids, shown.measures.as_ref().unwrap().volume))
        };
        assert_eq!(volume(&dry), volume(&real));
    }
    let contains = async |at: [f64; 3]| {
        let request = ContainsRequest {
            scene: "part".to_owned(),
            at: vector(at),
        };
        server
            .client()
            .contains(request)
            .await
            .unwrap()
            .into_inner()
    };
    let inside = contains([20.0, 11.0, -1.0]).await;
    assert_eq!((inside.side(), inside.solid.unwrap().id), (Side::Inside, 1));
    let boundary = contains([20.0, 11.0, -2.0]).await;
    assert_eq!(
        (boundary.side(), boundary.solid.unwrap().id),
        (Side::Boundary, 1)
    );
    let outside = contains([20.0, 11.0, -2.1]).await;
    assert_eq!(
        (outside.side(), outside.solid, outside.cube),
        (Side::Outside, None, None)
    );
    assert_eq!(outside.point, vector([20.0, 11.0, -2.1]));
}

/// Shapes come later, too, and never change.
#[tokio::test]
async fn shapes_are_defined_once() {
    let server = Server::start().await;
    create(&server, "part", settings()).await.unwrap();
    let define = |shape: Option<Shape>| {
        let request = DefineShapeRequest {
            scene: "part".to_owned(),
            name: "k".to_owned(),
            shape,
        };
        let mut client = server.client();
        async move {
            client
                .define_shape(request)
                .await
                .map(tonic::Response::into_inner)
        }
    };
    let several = shape(Form::Parts(Shapes {
        shapes: vec![
            shape(Form::Flat(cutter(6.0))),
            shape(Form::Hull(Points {
                points: [
                    [0.0, 0.0, 20.0],
                    [8.0, 0.0, 20.0],
                    [0.0, 8.0, 20.0],
                    [0.0, 0.0, 30.0],
                ]
                .into_iter()
                .filter_map(vector)
                .collect(),
            })),
        ],
    }));
    let first = define(Some(several.clone())).await.unwrap();
    assert!(first.polygon_error.unwrap().inside > 0.2);
    let again = define(first.shape.clone()).await.unwrap();
    assert_eq!(again, first);
    let other = define(Some(cuboid([1.0; 3]))).await.unwrap_err();
    refused(&other, Code::AlreadyExists, "shape-exists");
    let nothing = define(None).await.unwrap_err();
    assert_eq!(
        refused(&nothing, Code::InvalidArgument, "invalid"),
        ["shape"]
    );
    let deep = shape(Form::Parts(Shapes {
        shapes: vec![several],
    }));
    let deep = define(Some(deep)).await.unwrap_err();
    assert_eq!(
        refused(&deep, Code::InvalidArgument, "invalid"),
        ["shape.parts[0]"]
    );
}

/// Refusals name the place, and change nothing.
#[tokio::test]
async fn what_is_wrong_is_named_with_its_place() {
    let server = Server::start().await;
    create(&server, "part", settings()).await.unwrap();
    server.scene("cubes", 6).await;
    server.change("part", part()).await.unwrap();
    let before = totals(&server, "part").await;
    let column = |values: &[i32]| values.to_vec();
    let good = Change {
        shapes: vec!["b".to_owned()],
        x: vec![0],
        y: vec![0],
        z: vec![0],
        ..Change::default()
    };
    let wrong: [(Change, &[&str]); 9] = [
        (
            Change {
                y: vec![],
                ..good.clone()
            },
            &["change.y"],
        ),
        (
            Change {
                to_x: vec![1],
                ..good.clone()
            },
            &["change.to_y", "change.to_z"],
        ),
        (
            Change {
                shape: vec![0, 0],
                ..good.clone()
            },
            &["change.shape"],
        ),
        (
            Change {
                shape: vec![1],
                ..good.clone()
            },
            &["change.shape[0]"],
        ),
        (
            Change {
                shapes: vec![],
                ..good.clone()
            },
            &["change.shapes"],
        ),
        (
            Change {
                shapes: vec!["b".to_owned(), "none".to_owned()],
                ..good.clone()
            },
            &["change.shapes[1]"],
        ),
        (
            Change {
                insert_id: vec![4, 5],
                ..good.clone()
            },
            &["change.insert_id"],
        ),
        (
            Change {
                x: column(&[0, 0]),
                y: column(&[0, i32::MIN]),
                z: column(&[0, 0]),
                to_x: column(&[1 << 22, 0]),
                to_y: column(&[0, 0]),
                to_z: column(&[0, 0]),
                ..good.clone()
            },
            &["change.to_x[0]", "change.y[1]"],
        ),
        (
            Change {
                hulls: vec![
                    Hull {
                        x: vec![0, 1, 0, 1],
                        y: vec![0, 0, 1, 1],
                        z: vec![0; 4],
                    },
                    Hull {
                        x: vec![0],
                        y: vec![],
                        z: vec![0],
                    },
                ],
                insert_id: vec![4, 4, 4],
                ..good.clone()
            },
            &["change.hulls[0]", "change.hulls[1].y"],
        ),
    ];
    for (change, places) in wrong {
        let status = server.change("part", change.clone()).await.unwrap_err();
        assert_eq!(
            refused(&status, Code::InvalidArgument, "invalid"),
            places,
            "{change:?}"
        );
    }
    let twice = Change {
        insert_id: vec![4, 4],
        shapes: vec!["b".to_owned()],
        x: vec![0, 1],
        y: vec![0, 0],
        z: vec![0, 0],
        ..Change::default()
    };
    let status = server.change("part", twice).await.unwrap_err();
    assert_eq!(
        refused(&status, Code::InvalidArgument, "invalid"),
        ["change.insert_id[1]"]
    );
    let taken = Change {
        insert_id: vec![9],
        ..good.clone()
    };
    let status = server.change("part", taken).await.unwrap_err();
    assert_eq!(
        refused(&status, Code::AlreadyExists, "id-conflict"),
        ["change.insert_id[0]"]
    );
    assert_eq!(totals(&server, "part").await, before);

    // The other kind.
    let status = server
        .change(
            "cubes",
            Change {
                insert_id: vec![1],
                ..good
            },
        )
        .await
        .unwrap_err();
    assert_eq!(
        refused(&status, Code::InvalidArgument, "invalid"),
        ["change.shapes"]
    );
    let status = server.change("part", row(20..21)).await.unwrap_err();
    assert_eq!(
        refused(&status, Code::InvalidArgument, "invalid"),
        ["change.shapes"]
    );
    let request = GetCubeRequest {
        scene: "part".to_owned(),
        id: 1,
    };
    let status = server.client().get_cube(request).await.unwrap_err();
    refused(&status, Code::FailedPrecondition, "other-kind");
    let request = ListSolidsRequest {
        scene: "cubes".to_owned(),
    };
    let status = server.client().list_solids(request).await.unwrap_err();
    refused(&status, Code::FailedPrecondition, "other-kind");

    // Settings.
    let both = CreateSceneRequest {
        scene: "both".to_owned(),
        settings: Some(SceneSettings {
            edge: 1.0,
            ..SceneSettings::default()
        }),
        solids: Some(settings()),
    };
    let status = server.client().create_scene(both).await.unwrap_err();
    assert_eq!(
        refused(&status, Code::InvalidArgument, "invalid"),
        ["solids"]
    );
    let bad = SolidSceneSettings {
        steps_per_unit: Some(0),
        rounding: 9,
        stock_form: Some(StockForm::Stock(Block {
            min: vector([0.0; 3]),
            max: None,
        })),
        shapes: HashMap::from([(
            "t".to_owned(),
            shape(Form::Vee(Cutter {
                rings: Some(1 << 20),
                polygon: 9,
                ..cutter(6.0)
            })),
        )]),
        ..SolidSceneSettings::default()
    };
    let status = create(&server, "bad", bad).await.unwrap_err();
    let mut places = refused(&status, Code::InvalidArgument, "invalid");
    places.sort();
    assert_eq!(
        places,
        [
            "solids.rounding",
            "solids.shapes.t.vee.polygon",
            "solids.shapes.t.vee.rings",
            "solids.steps_per_unit",
            "solids.stock.max",
        ]
    );
    let history = GetHistoryRequest {
        scene: "part".to_owned(),
        detail: NONE,
        ..GetHistoryRequest::default()
    };
    let rows = server
        .client()
        .get_history(history)
        .await
        .unwrap()
        .into_inner();
    let rows: Vec<_> = rows.collect().await;
    assert_eq!(rows.len(), 1);
}
