//! Each call, and that HTTP sees the same.

use serde_json::{Value, json};
use tokio_stream::StreamExt;
use tonic::Code;
use union3d::wire::proto::{
    Anchor, ApplyChangeRequest, AuditSceneRequest, Change, ContainsRequest, CreateSceneRequest,
    DeleteSceneRequest, GetCubeRequest, GetHistoryRequest, GetMassPropertiesRequest,
    GetSceneRequest, ListCubesRequest, ListScenesRequest, MassProperties, RevertSceneRequest,
    Rounding, SceneSettings, SceneState, Side, Vector, WatchMassPropertiesRequest,
};

use crate::server::{NONE, Server, VOLUME, deletion, refused, row};

/// The same mass properties as HTTP has them.
fn as_json(shown: &MassProperties) -> Value {
    let point = |point: &Option<Vector>| point.as_ref().map(|at| json!([at.x, at.y, at.z]));
    let edges = shown.edge_length.unwrap();
    let tensor = shown.inertia.unwrap();
    let vertices = shown.vertices.unwrap();
    let exact = shown.exact.clone().unwrap();
    let exact_edges = exact.edge_length.unwrap();
    let triple = |of: Option<union3d::wire::proto::ExactVector>| {
        let of = of.unwrap();
        json!([of.x, of.y, of.z])
    };
    let products = exact.product_moments4.unwrap();
    json!({
        "scene": shown.scene, "seq": shown.seq, "cubes": shown.cubes,
        "volume": shown.volume, "area": shown.area,
        "edge_length": {"total": edges.total, "convex": edges.convex, "concave": edges.concave, "crossing": edges.crossing},
        "mass": shown.mass, "mean_curvature": shown.mean_curvature,
        "centroid": point(&shown.centroid),
        "inertia": [[tensor.xx, tensor.xy, tensor.zx], [tensor.xy, tensor.yy, tensor.yz], [tensor.zx, tensor.yz, tensor.zz]],
        "bounds": shown.bounds.as_ref().map(|bounds| json!({"min": point(&bounds.min), "max": point(&bounds.max)})),
        "euler_characteristic": shown.euler_characteristic,
        "vertices": {"total": vertices.total, "corner": vertices.corner, "edge_face": vertices.edge_face,
            "three_face": vertices.three_face, "degenerate": vertices.degenerate},
        "exact": {
            "steps_per_unit": exact.steps_per_unit, "volume": exact.volume, "area": exact.area,
            "area_by_axis": triple(exact.area_by_axis),
            "edge_length": {"total": exact_edges.total, "convex": exact_edges.convex,
                "concave": exact_edges.concave, "crossing": exact_edges.crossing},
            "first_moments2": triple(exact.first_moments2), "second_moments3": triple(exact.second_moments3),
            "product_moments4": [products.xy, products.yz, products.zx],
        },
    })
}

/// Three cubes of edge 6, two of which overlap off-centre.
fn part() -> Change {
    Change {
        insert_id: vec![1, 2, 3],
        x: vec![0, 3, 20],
        y: vec![0, 1, -7],
        z: vec![0, 2, 5],
        ..Change::default()
    }
}

#[tokio::test]
async fn scenes_come_and_go_as_over_http() {
    let server = Server::start().await;
    let mut client = server.client();
    let wanted = |edge| CreateSceneRequest {
        scene: "part".to_owned(),
        settings: Some(SceneSettings {
            edge,
            anchor: Anchor::Center.into(),
            ..SceneSettings::default()
        }),
        solids: None,
    };
    let made = client.create_scene(wanted(6.0)).await.unwrap().into_inner();
    assert!(made.created);
    let scene = made.scene.unwrap();
    assert_eq!(
        (&*scene.name, scene.seq, scene.cubes),
        ("part", Some(0), Some(0))
    );
    assert_eq!(scene.state(), SceneState::Running);
    let settings = scene.settings.clone().unwrap();
    assert_eq!(settings.steps_per_unit, Some(1000));
    assert_eq!((settings.unit(), settings.density()), ("mm", 1.0));
    assert_eq!(
        (settings.anchor(), settings.rounding()),
        (Anchor::Center, Rounding::Nearest)
    );

    // What HTTP answers is the same scene; and the same settings again are no other.
    let (status, shown) = server.get("/v1/scenes/part").await;
    assert_eq!(
        (status, &shown["incarnation"]),
        (200, &json!(scene.incarnation))
    );
    let again = client.create_scene(wanted(6.0)).await.unwrap().into_inner();
    assert_eq!((again.created, again.scene), (false, Some(scene.clone())));
    let other = client.create_scene(wanted(7.0)).await.unwrap_err();
    refused(&other, Code::AlreadyExists, "scene-exists");

    server.scene("another", 1).await;
    let listed = client
        .list_scenes(ListScenesRequest {})
        .await
        .unwrap()
        .into_inner();
    let names: Vec<_> = listed.scenes.iter().map(|scene| &*scene.name).collect();
    assert_eq!(names, ["another", "part"]);
    let get = GetSceneRequest {
        scene: "part".to_owned(),
    };
    let found = client.get_scene(get.clone()).await.unwrap().into_inner();
    assert_eq!(found.scene, Some(scene));

    let drop = DeleteSceneRequest {
        scene: "part".to_owned(),
    };
    client.delete_scene(drop.clone()).await.unwrap();
    refused(
        &client.get_scene(get).await.unwrap_err(),
        Code::NotFound,
        "no-such-scene",
    );
    refused(
        &client.delete_scene(drop).await.unwrap_err(),
        Code::NotFound,
        "no-such-scene",
    );
    assert_eq!(server.get("/v1/scenes/part").await.0, 404);
}

#[tokio::test]
async fn both_apis_see_the_same_state() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let outcome = server.change("part", part()).await.unwrap();
    assert_eq!((outcome.seq, outcome.inserted, outcome.deleted), (1, 3, 0));
    let shown = outcome.mass_properties.unwrap();
    assert_eq!(shown, server.totals("part").await);
    let (_, there) = server.get("/v1/scenes/part/mass-properties").await;
    assert_eq!(as_json(&shown), there);

    // And what comes over HTTP is there over gRPC.
    let body =
        json!({"delete": [3], "insert": [{"id": 4, "at": [1, 1, 1]}, {"id": 1, "at": [0, 0, 0]}]});
    let (status, answer) = server.post("/v1/scenes/part/changes", &body).await;
    assert_eq!((status, &answer["unchanged"]), (200, &json!(1)));
    assert_eq!(
        as_json(&server.totals("part").await),
        answer["mass_properties"]
    );

    let none = server
        .change("part", deletion([1, 2, 4].into_iter()))
        .await
        .unwrap();
    let none = none.mass_properties.unwrap();
    assert_eq!((none.centroid, none.bounds.as_ref()), (None, None));
    assert_eq!(
        as_json(&none),
        server.get("/v1/scenes/part/mass-properties").await.1
    );
}

#[tokio::test]
async fn a_change_is_answered_as_far_as_is_wanted() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let mut client = server.client();
    let mut request = ApplyChangeRequest {
        scene: "part".to_owned(),
        change: Some(row(1..3)),
        detail: VOLUME,
        ..ApplyChangeRequest::default()
    };
    let answer = client
        .apply_change(request.clone())
        .await
        .unwrap()
        .into_inner();
    let outcome = answer.outcome.unwrap();
    assert_eq!(outcome.volumes.unwrap().union, 7.0 * 6.0 * 6.0);
    assert_eq!(outcome.mass_properties, None);
    request.detail = NONE;
    let answer = client
        .apply_change(request.clone())
        .await
        .unwrap()
        .into_inner();
    let outcome = answer.outcome.unwrap();
    assert_eq!((outcome.seq, outcome.unchanged), (1, 2));
    assert_eq!((outcome.volumes, outcome.mass_properties), (None, None));
    // Without ids the server numbers the cubes; a key makes the retry safe, also over HTTP.
    let mut change = row(5..7);
    change.insert_id.clear();
    request.idempotency_key = Some("once".to_owned());
    request.change = Some(change);
    let first = client
        .apply_change(request.clone())
        .await
        .unwrap()
        .into_inner()
        .outcome
        .unwrap();
    let assigned = first.assigned.unwrap();
    assert_eq!(
        (assigned.first, assigned.last, first.replayed),
        (3, 4, false)
    );
    let again = client
        .apply_change(request.clone())
        .await
        .unwrap()
        .into_inner()
        .outcome
        .unwrap();
    assert!(again.replayed);
    assert_eq!((again.seq, again.assigned), (first.seq, first.assigned));
    let body = prost::Message::encode_to_vec(request.change.as_ref().unwrap());
    let answer = reqwest::Client::new()
        .post(format!("{}/v1/scenes/part/changes", server.http))
        .header("content-type", "application/x-protobuf")
        .header("idempotency-key", "once")
        .body(body)
        .send()
        .await
        .unwrap();
    assert_eq!(answer.headers()["idempotency-replayed"], "true");
    request.change = Some(row(9..10));
    let other = client.apply_change(request).await.unwrap_err();
    refused(&other, Code::FailedPrecondition, "idempotency-key-reused");
}

#[tokio::test]
async fn the_past_is_answered_and_gone_back_to() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let mut client = server.client();
    let mut states = vec![server.totals("part").await];
    for id in 1..=5 {
        let outcome = server.change("part", row(id..id + 1)).await.unwrap();
        states.push(outcome.mass_properties.unwrap());
    }
    let at = |at, wait| GetMassPropertiesRequest {
        scene: "part".to_owned(),
        at,
        wait,
    };
    for (seq, state) in states.iter().enumerate() {
        let answer = client
            .get_mass_properties(at(Some(seq as u64), None))
            .await
            .unwrap();
        assert_eq!(answer.into_inner().mass_properties.as_ref(), Some(state));
    }
    let waited = client.get_mass_properties(at(None, Some(5))).await.unwrap();
    assert_eq!(waited.into_inner().mass_properties.as_ref(), states.last());

    let history = GetHistoryRequest {
        scene: "part".to_owned(),
        from: Some(2),
        to: Some(4),
        ..GetHistoryRequest::default()
    };
    let rows = client
        .get_history(history.clone())
        .await
        .unwrap()
        .into_inner();
    let rows: Vec<_> = rows.map(|row| row.unwrap()).collect().await;
    let seqs: Vec<_> = rows
        .iter()
        .map(|row| (row.seq, row.inserted, row.deleted))
        .collect();
    assert_eq!(seqs, [(2, 1, 0), (3, 1, 0), (4, 1, 0)]);
    assert_eq!(rows[1].mass_properties.as_ref(), Some(&states[3]));
    assert!(rows[1].time.unwrap().seconds > 1_700_000_000);
    let volumes = GetHistoryRequest {
        detail: VOLUME,
        ..history
    };
    let rows = client.get_history(volumes).await.unwrap().into_inner();
    let rows: Vec<_> = rows
        .map(|row| row.unwrap().volumes.unwrap().union)
        .collect()
        .await;
    assert_eq!(
        rows,
        states[2..5]
            .iter()
            .map(|state| state.volume)
            .collect::<Vec<_>>()
    );

    let back = RevertSceneRequest {
        scene: "part".to_owned(),
        to: 2,
        ..RevertSceneRequest::default()
    };
    let outcome = client
        .revert_scene(back.clone())
        .await
        .unwrap()
        .into_inner()
        .outcome
        .unwrap();
    assert_eq!((outcome.seq, outcome.deleted), (6, 3));
    let shown = outcome.mass_properties.unwrap();
    assert_eq!(shown.exact, states[2].exact);
    let (status, again) = server
        .post("/v1/scenes/part/revert", &json!({"to": 5}))
        .await;
    assert_eq!((status, &again["seq"]), (200, &json!(7)));
    assert_eq!(server.totals("part").await.exact, states[5].exact);
    let far = RevertSceneRequest { to: 99, ..back };
    refused(
        &client.revert_scene(far).await.unwrap_err(),
        Code::OutOfRange,
        "seq-not-reached",
    );
}

#[tokio::test]
async fn cubes_and_points_are_found() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    server.change("part", part()).await.unwrap();
    let mut client = server.client();
    let get = |id| GetCubeRequest {
        scene: "part".to_owned(),
        id,
    };
    let cube = client
        .get_cube(get(3))
        .await
        .unwrap()
        .into_inner()
        .cube
        .unwrap();
    assert_eq!((cube.id, cube.x, cube.y, cube.z), (3, 20, -7, 5));
    assert_eq!(
        cube.at,
        Some(Vector {
            x: 20.0,
            y: -7.0,
            z: 5.0
        })
    );
    refused(
        &client.get_cube(get(9)).await.unwrap_err(),
        Code::NotFound,
        "no-such-cube",
    );

    let contains = |x| ContainsRequest {
        scene: "part".to_owned(),
        at: Some(Vector { x, y: 1.0, z: 1.0 }),
    };
    for (x, side) in [
        (1.0, Side::Inside),
        (0.0, Side::Boundary),
        (-1.0, Side::Outside),
    ] {
        let found = client.contains(contains(x)).await.unwrap().into_inner();
        assert_eq!((found.side(), found.seq), (side, 1), "{x}");
        assert_eq!(
            found.cube.map(|cube| cube.id),
            (side != Side::Outside).then_some(1)
        );
    }
    let nowhere = client.contains(contains(f64::NAN)).await.unwrap_err();
    assert_eq!(refused(&nowhere, Code::InvalidArgument, "invalid"), ["at"]);

    let audit = AuditSceneRequest {
        scene: "part".to_owned(),
    };
    let audit = client.audit_scene(audit).await.unwrap().into_inner();
    assert_eq!((audit.seq, audit.cubes), (1, 3));
}

#[tokio::test]
async fn a_listing_is_a_change_that_makes_the_same_scene() {
    let server = Server::start().await;
    server.scene("part", 3).await;
    server.change("part", row(1..10_001)).await.unwrap();
    server.scene("copy", 3).await;
    let list = ListCubesRequest {
        scene: "part".to_owned(),
    };
    let mut pieces = server.client().list_cubes(list).await.unwrap().into_inner();
    let mut messages = 0;
    while let Some(piece) = pieces.next().await {
        let piece = piece.unwrap();
        assert_eq!(piece.seq, 1);
        server.change("copy", piece.cubes.unwrap()).await.unwrap();
        messages += 1;
    }
    assert!(messages > 1, "a long listing comes in pieces");
    let (copy, part) = (server.totals("copy").await, server.totals("part").await);
    assert_eq!((copy.cubes, copy.exact), (10_000, part.exact));
}

#[tokio::test]
async fn a_watch_shows_the_newest_until_the_scene_goes() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let watch = WatchMassPropertiesRequest {
        scene: "part".to_owned(),
    };
    let mut watch = server
        .client()
        .watch_mass_properties(watch)
        .await
        .unwrap()
        .into_inner();
    for seq in 0..5 {
        let shown = watch
            .next()
            .await
            .unwrap()
            .unwrap()
            .mass_properties
            .unwrap();
        assert_eq!(shown.seq, seq);
        assert_eq!(shown.cubes, seq);
        server.change("part", row(seq + 1..seq + 2)).await.unwrap();
    }
    let drop = DeleteSceneRequest {
        scene: "part".to_owned(),
    };
    server.client().delete_scene(drop).await.unwrap();
    let end = loop {
        match watch.next().await.unwrap() {
            Ok(shown) => assert_eq!(shown.mass_properties.unwrap().seq, 5),
            Err(end) => break end,
        }
    };
    refused(&end, Code::NotFound, "no-such-scene");
}

/// A block of 100 x 10 x 10, cut from above: the same totals, moves and rates as over HTTP.
#[tokio::test]
async fn a_stock_is_cut_move_by_move() {
    let server = Server::start().await;
    let mut client = server.client();
    let corner = |x, y, z| Some(Vector { x, y, z });
    let settings = SceneSettings {
        edge: 4.0,
        steps_per_unit: Some(1),
        stock: Some(union3d::wire::proto::Box {
            min: corner(0.0, 0.0, -10.0),
            max: corner(100.0, 10.0, 0.0),
        }),
        ..SceneSettings::default()
    };
    let create = |settings| CreateSceneRequest {
        scene: "block".to_owned(),
        settings: Some(settings),
        solids: None,
    };
    let mut wrong = settings.clone();
    wrong.stock.as_mut().unwrap().max = corner(100.0, 0.0, 0.0);
    let refusal = client
        .create_scene(create(wrong.clone()))
        .await
        .unwrap_err();
    let fields = refused(&refusal, Code::InvalidArgument, "invalid");
    assert_eq!(fields, ["settings.stock.max[1]"]);
    wrong.stock.as_mut().unwrap().max = None;
    let refusal = client.create_scene(create(wrong)).await.unwrap_err();
    let fields = refused(&refusal, Code::InvalidArgument, "invalid");
    assert_eq!(fields, ["settings.stock.max"]);
    let made = client.create_scene(create(settings.clone())).await.unwrap();
    let made = made.into_inner().scene.unwrap().settings.unwrap();
    assert_eq!(made.stock, settings.stock);

    // One cube a move, 2 deep; the third cuts air.
    let cut = |id: u64, x: i32, z: i32, seconds| Change {
        insert_id: vec![id],
        x: vec![x],
        y: vec![3],
        z: vec![z],
        r#move: Some(100 + id),
        duration: Some(seconds),
        ..Change::default()
    };
    let mut last = None;
    for change in [
        cut(1, 10, -2, 0.5),
        cut(2, 12, -2, 0.25),
        cut(3, 10, 50, 1.0),
    ] {
        last = Some(server.change("block", change).await.unwrap());
    }
    let shown = last.unwrap().mass_properties.unwrap();
    let (removed, remaining) = (shown.removed.unwrap(), shown.remaining.unwrap());
    assert_eq!(removed.volume, 6.0 * 4.0 * 2.0);
    assert_eq!(removed.volume + remaining.volume, 10_000.0);
    let (_, there) = server.get("/v1/scenes/block/mass-properties").await;
    assert_eq!(
        there["removed"]["exact"]["volume"],
        removed.exact.unwrap().volume
    );
    assert_eq!(there["remaining"]["area"], remaining.area);
    assert_eq!(
        there["remaining"]["inertia"][0][1],
        remaining.inertia.unwrap().xy
    );

    let history = GetHistoryRequest {
        scene: "block".to_owned(),
        move_from: Some(102),
        detail: VOLUME,
        ..GetHistoryRequest::default()
    };
    let rows = client
        .get_history(history.clone())
        .await
        .unwrap()
        .into_inner();
    let rows: Vec<_> = rows.map(|row| row.unwrap()).collect().await;
    let seen: Vec<_> = rows
        .iter()
        .map(|row| {
            (
                row.r#move(),
                row.duration(),
                row.volume_removed,
                row.removal_rate(),
            )
        })
        .collect();
    assert_eq!(seen, [(102, 0.25, 16.0, 64.0), (103, 1.0, 0.0, 0.0)]);
    assert_eq!(rows[0].volume_removed_exact, "16");
    let volumes = rows[1].volumes.clone().unwrap();
    assert_eq!((volumes.removed(), volumes.remaining()), (48.0, 9_952.0));
    let (_, there) = server.get("/v1/scenes/block/history?move_from=102").await;
    assert_eq!(there["changes"][0]["removal_rate"], rows[0].removal_rate());
    let first = GetHistoryRequest {
        limit: Some(1),
        move_to: Some(102),
        ..history
    };
    let rows = client.get_history(first).await.unwrap().into_inner();
    let rows: Vec<_> = rows.map(|row| row.unwrap().r#move()).collect().await;
    assert_eq!(rows, [102]);
    let wrong = cut(9, 0, 0, -1.0);
    let refusal = server.change("block", wrong).await.unwrap_err();
    assert_eq!(
        refused(&refusal, Code::InvalidArgument, "invalid"),
        ["change.duration"]
    );
}
