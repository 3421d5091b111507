//! The sidecar's key `head`: which decoding a model's output needs.

use serde::Deserialize;

/// How a model's output is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeadSpec {
    /// Decoding of the head.
    pub kind: HeadKind,
    /// Cell sizes of the output's levels, px, in their order.
    pub strides: Vec<usize>,
    /// Bins of each side's distance (NanoDet-Plus and PicoDet).
    pub bins: usize,
    /// Score columns.
    pub classes: usize,
}

/// The decodings that verge knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HeadKind {
    /// Scores after a sigmoid, then four distances as distributions over bins: `[1, n, c + 4b]`.
    #[serde(alias = "nanodet", alias = "nanodet_plus")]
    NanodetPlus,
    /// The same with cells about their middle: scores by level, then distances by level.
    Picodet,
    /// Centre, size as logarithm, objectness, scores in cells: `[1, n, 5 + c]`.
    Yolox,
    /// The same in pixels.
    #[serde(alias = "yolox_decoded")]
    YoloxDecoded,
    /// Centre, size, objectness, scores in pixels: `[1, n, 5 + c]`.
    Yolov5,
    /// YOLOv8 and v11: centre, size, scores in pixels: `[1, 4 + c, n]`.
    #[serde(alias = "yolov11", alias = "yolo11")]
    Yolov8,
    /// Suppressed in the net: edges, score, class: `[1, n, 6]`.
    #[serde(alias = "end-to-end", alias = "end_to_end")]
    End2end,
}

impl HeadKind {
    /// As it is written in a sidecar.
    pub fn name(self) -> &'static str {
        match self {
            Self::NanodetPlus => "nanodet-plus",
            Self::Picodet => "picodet",
            Self::Yolox => "yolox",
            Self::YoloxDecoded => "yolox-decoded",
            Self::Yolov5 => "yolov5",
            Self::Yolov8 => "yolov8",
            Self::End2end => "end2end",
        }
    }

    fn strides(self) -> &'static [usize] {
        match self {
            Self::NanodetPlus | Self::Picodet => &[8, 16, 32, 64],
            _ => &[8, 16, 32],
        }
    }
}

/// The key `head`: a kind, and where it differs from the usual.
#[derive(Clone, Debug)]
pub struct HeadKey {
    kind: HeadKind,
    pub(super) strides: Option<Vec<usize>>,
    pub(super) bins: Option<usize>,
    pub(super) classes: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HeadTable {
    kind: HeadKind,
    strides: Option<Vec<usize>>,
    bins: Option<usize>,
    classes: Option<usize>,
}

impl<'de> Deserialize<'de> for HeadKey {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = HeadKey;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("the name of a head, or a table with its kind")
            }

            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<HeadKey, E> {
                use serde::de::IntoDeserializer;
                let kind = HeadKind::deserialize(name.into_deserializer())?;
                Ok(HeadKey { kind, strides: None, bins: None, classes: None })
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<HeadKey, A::Error> {
                let from = serde::de::value::MapAccessDeserializer::new(map);
                let HeadTable { kind, strides, bins, classes } = HeadTable::deserialize(from)?;
                Ok(HeadKey { kind, strides, bins, classes })
            }
        }
        from.deserialize_any(Visitor)
    }
}

impl HeadKey {
    /// With what the sidecar leaves out, as outputs of these shapes have it.
    pub(super) fn spec(&self, outputs: &[Vec<usize>]) -> HeadSpec {
        let kind = self.kind;
        let strides = self.strides.clone().unwrap_or_else(|| kind.strides().to_vec());
        let bins = self.bins.unwrap_or(8);
        let axis = |index: usize| outputs.first().and_then(|shape| shape.get(index)).copied();
        let (a, b) = (axis(1).unwrap_or(0), axis(2).unwrap_or(0));
        let classes = self.classes.unwrap_or(match kind {
            HeadKind::NanodetPlus => b.saturating_sub(4 * bins),
            HeadKind::Picodet => b,
            HeadKind::Yolox | HeadKind::YoloxDecoded | HeadKind::Yolov5 => b.saturating_sub(5),
            HeadKind::Yolov8 => a.min(b).saturating_sub(4),
            HeadKind::End2end => 0,
        });
        HeadSpec { kind, strides, bins, classes }
    }
}
