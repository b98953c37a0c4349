//! A scene of solids on a server, as a program needs it: made if it is not there, and else of the same lattice, unit and stock.

use std::collections::BTreeSet;
use std::fmt::Debug;

use serde::Serialize;
use serde_json::{Value, json};
use tonic::Code;
use union3d::wire::proto::solid_scene_settings::StockForm;
use union3d::wire::proto::{
    CreateSceneRequest, DefineShapeRequest, GetSceneRequest, Scene, SolidSceneSettings,
};
use union3d::wire::solids::SolidStockDocument;

use super::super::super::client::Client;
use super::super::grpc;
use super::Failure;
use super::bodies::Swept;

/// What a scene must be like for a program.
pub(super) struct Wanted {
    pub(super) name: String,
    pub(super) steps_per_unit: u32,
    pub(super) unit: &'static str,
    pub(super) stock: Option<SolidStockDocument>,
}

/// A scene that is there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Found {
    /// Its newest change.
    pub(super) seq: u64,
    /// How many solids it holds.
    pub(super) solids: u64,
}

/// The settings that a scene is made with over HTTP.
#[derive(Serialize)]
struct NewScene<'a> {
    kind: &'static str,
    steps_per_unit: u32,
    unit: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    stock: Option<&'a SolidStockDocument>,
}

impl Wanted {
    /// Opens the scene over gRPC, made if it is not there.
    pub(super) async fn open_grpc(
        &self,
        client: &mut grpc::Client,
        server: &str,
    ) -> Result<Found, Failure> {
        let settings = SolidSceneSettings {
            steps_per_unit: Some(self.steps_per_unit),
            unit: Some(self.unit.to_owned()),
            stock_form: self.stock.clone().map(Into::into),
            ..SolidSceneSettings::default()
        };
        let create = CreateSceneRequest {
            scene: self.name.clone(),
            settings: None,
            solids: Some(settings),
        };
        match client.create_scene(create).await {
            Ok(answer) => found(server, &answer.into_inner().scene.unwrap_or_default()),
            // It may be there with settings that differ in what does not matter here.
            Err(status) => {
                let there = self.find_grpc(client, server).await?;
                there.ok_or_else(|| grpc::refused(server)(status).into())
            }
        }
    }

    /// Finds the scene over gRPC; none when it is not there.
    pub(super) async fn find_grpc(
        &self,
        client: &mut grpc::Client,
        server: &str,
    ) -> Result<Option<Found>, Failure> {
        let request = GetSceneRequest {
            scene: self.name.clone(),
        };
        let scene = match client.get_scene(request).await {
            Ok(answer) => answer.into_inner().scene.unwrap_or_default(),
            Err(status) if status.code() == Code::NotFound => return Ok(None),
            Err(status) => return Err(grpc::refused(server)(status).into()),
        };
        let Some(settings) = &scene.solid_settings else {
            return Err(self.other("kind", "cubes", "solids"));
        };
        let stock: Option<StockForm> = self.stock.clone().map(Into::into);
        let steps_per_unit = Some(self.steps_per_unit);
        self.compare("steps_per_unit", &settings.steps_per_unit, &steps_per_unit)?;
        self.compare("unit", &settings.unit.as_deref(), &Some(self.unit))?;
        self.compare("stock", &settings.stock_form, &stock)?;
        found(server, &scene).map(Some)
    }

    /// Finds the scene over HTTP; none when it is not there.
    pub(super) async fn find_http(&self, client: &mut Client) -> Result<Option<Found>, Failure> {
        let Some(scene) = client.describe().await? else {
            return Ok(None);
        };
        if scene["kind"] != "solids" {
            return Err(self.other("kind", "cubes", "solids"));
        }
        let wanted = [
            ("steps_per_unit", json!(self.steps_per_unit)),
            ("unit", json!(self.unit)),
            ("stock", json!(self.stock)),
        ];
        for (setting, wanted) in wanted {
            self.compare(setting, &scene[setting], &wanted)?;
        }
        let number = |name: &str| {
            let number = scene[name].as_u64();
            number.ok_or_else(|| format!("{} answers without {name}", client.url()))
        };
        Ok(Some(Found {
            seq: number("seq")?,
            solids: number("solids")?,
        }))
    }

    /// Makes the scene over HTTP.
    pub(super) async fn create_http(&self, client: &Client) -> Result<Found, Failure> {
        let settings = NewScene {
            kind: "solids",
            steps_per_unit: self.steps_per_unit,
            unit: self.unit,
            stock: self.stock.as_ref(),
        };
        client.create(&settings).await?;
        Ok(Found { seq: 0, solids: 0 })
    }

    /// A program is milled into a scene without solids: theirs could have the same ids, and nobody knows which lines they came from.
    pub(super) fn check_empty(&self, found: Found) -> Result<Found, Failure> {
        if found.solids == 0 {
            return Ok(found);
        }
        Err(format!(
            "scene {:?} has {} solids already: --replace changes them to those of this program, or choose another --scene",
            self.name, found.solids
        )
        .into())
    }

    fn compare<T: PartialEq + Debug>(
        &self,
        setting: &str,
        there: &T,
        wanted: &T,
    ) -> Result<(), Failure> {
        if there == wanted {
            return Ok(());
        }
        Err(self.other(setting, &format!("{there:?}"), &format!("{wanted:?}")))
    }

    fn other(&self, setting: &str, there: &str, wanted: &str) -> Failure {
        format!(
            "scene {:?} exists with {setting} {there}, this program needs {wanted}: choose another --scene, or the same {setting}",
            self.name
        )
        .into()
    }
}

/// What a server says of a scene that is there.
fn found(server: &str, scene: &Scene) -> Result<Found, Failure> {
    let missing = grpc::without(server);
    Ok(Found {
        seq: scene.seq.ok_or_else(|| missing("the scene's seq"))?,
        solids: scene.solids.ok_or_else(|| missing("the scene's solids"))?,
    })
}

/// The shapes of a scene that this run has defined.
#[derive(Default)]
pub(super) struct Defined(BTreeSet<String>);

impl Defined {
    /// Whether a shape is still to be defined; from now on it is.
    fn is_new(&mut self, swept: &Swept) -> bool {
        !self.0.contains(&swept.name) && self.0.insert(swept.name.clone())
    }

    /// Defines a shape over gRPC, unless it is.
    pub(super) async fn define_grpc(
        &mut self,
        client: &mut grpc::Client,
        server: &str,
        scene: &str,
        swept: &Swept,
    ) -> Result<(), Failure> {
        if self.is_new(swept) {
            let request = DefineShapeRequest {
                scene: scene.to_owned(),
                name: swept.name.clone(),
                shape: Some(swept.document.clone().into()),
            };
            let defined = client.define_shape(request).await;
            defined.map_err(grpc::refused(server))?;
        }
        Ok(())
    }

    /// Defines a shape over HTTP, unless it is.
    pub(super) async fn define_http(
        &mut self,
        client: &Client,
        swept: &Swept,
    ) -> Result<(), Failure> {
        if self.is_new(swept) {
            client.define(&swept.name, &swept.document).await?;
        }
        Ok(())
    }
}

/// A number in an answer over HTTP, written as a decimal.
pub(super) fn decimal<T: std::str::FromStr>(value: &Value) -> Option<T> {
    value.as_str()?.parse().ok()
}
