use alloc::collections::BTreeMap;
use alloc::sync::Arc;
use alloc::vec::Vec;

use crate::bitstream::BitstreamReader;
use crate::deblock::{self, MbInfo, MbType};
use crate::decode_cabac::CabacMbResult;
use crate::dpb::{
    DecodedPicture, Dpb, Motion, PictureMeta, PictureStructure, PictureWriter, ReferenceStatus,
};
use crate::error::DecodeError;
use crate::mv_pred::WeightContext;
use crate::nal::{NalUnit, NalUnitType};
use crate::pixel::Pixel;
use crate::pps::{parse_pps, Pps};
use crate::slice::{parse_slice_header, SliceHeader, SliceType};
use crate::slice_context::{SliceContext, SliceParams};
use crate::sps::{parse_sps, Sps};

/// Chroma sampling of a [`Frame`]'s U and V planes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChromaFormat {
    /// 4:2:0: chroma planes are half width and half height. Monochrome
    /// (4:0:0) streams also decode to this, with U and V filled with 128.
    #[default]
    Yuv420,
    /// 4:2:2: chroma planes are half width and full height.
    Yuv422,
}

impl ChromaFormat {
    /// Format of the chroma planes for `chroma_format_idc` (4:0:0 outputs
    /// mid-grey 4:2:0 planes).
    pub(crate) fn from_idc(chroma_format_idc: u32) -> Self {
        if chroma_format_idc == 2 {
            ChromaFormat::Yuv422
        } else {
            ChromaFormat::Yuv420
        }
    }

    /// log2 of the luma rows per chroma row: 1 for 4:2:0, 0 for 4:2:2.
    pub(crate) fn shift_y(self) -> u32 {
        match self {
            ChromaFormat::Yuv420 => 1,
            ChromaFormat::Yuv422 => 0,
        }
    }
}

/// A decoded YUV frame, 4:2:0 or 4:2:2 (see [`Frame::chroma_format`]).
///
/// The Y plane is `width × height` bytes; the U and V planes are each
/// [`chroma_width`](Frame::chroma_width) × [`chroma_height`](Frame::chroma_height)
/// bytes: `(width/2) × (height/2)` for 4:2:0, `(width/2) × height` for
/// 4:2:2. Pixels are stored row-major with no inter-row padding (stride ==
/// width). Monochrome (4:0:0) streams decode to the 4:2:0 layout with U and
/// V filled with 128, as FFmpeg outputs them.
///
/// Frames returned by [`Decoder::decode_nal`] are emitted in **decode order**,
/// not display order. To present them in the intended order, sort by
/// `pic_order_cnt` within each GOP. See the crate-level documentation for the
/// recommended pattern (and a common pitfall around IDR boundary handling).
#[derive(Debug, Clone)]
pub struct Frame {
    /// Display width in luma samples.
    pub width: u32,
    /// Display height in luma samples.
    pub height: u32,
    /// Luma plane, `width * height` samples, row-major.
    pub y: Vec<u8>,
    /// Cb chroma plane, `chroma_width() * chroma_height()` samples, row-major.
    pub u: Vec<u8>,
    /// Cr chroma plane, `chroma_width() * chroma_height()` samples, row-major.
    pub v: Vec<u8>,
    /// Picture order count — the H.264 spec's display ordering value.
    /// Use this to sort frames into display order within a GOP.
    pub pic_order_cnt: i32,
    /// Chroma sampling of `u` and `v`.
    pub chroma_format: ChromaFormat,
    /// Bits per sample, luma and chroma: 8, or 10. At 10 bits each
    /// sample takes two bytes of `y`/`u`/`v`, little-endian (FFmpeg's
    /// `yuv420p10le` / `yuv422p10le` layout); see [`Frame::sample`].
    pub bit_depth: u8,
}

impl Frame {
    /// Bytes per sample in `y`, `u` and `v`: 1, or 2 above 8 bits.
    pub fn bytes_per_sample(&self) -> usize {
        if self.bit_depth > 8 {
            2
        } else {
            1
        }
    }

    /// Sample `i` (in samples, row-major) of a plane, whatever the bit
    /// depth.
    pub fn sample(&self, plane: &[u8], i: usize) -> u16 {
        if self.bit_depth > 8 {
            u16::from_le_bytes([plane[2 * i], plane[2 * i + 1]])
        } else {
            plane[i] as u16
        }
    }

    /// Width of the U and V planes.
    pub fn chroma_width(&self) -> u32 {
        self.width / 2
    }

    /// Height of the U and V planes.
    pub fn chroma_height(&self) -> u32 {
        self.height >> self.chroma_format.shift_y()
    }
}

/// In-progress picture state shared across slices within the same frame.
#[derive(Clone)]
pub(crate) struct PictureState {
    pub(crate) frame: Frame,
    pub(crate) frame_num: u32,
    pub(crate) poc: i32,
    /// Top and bottom field POCs (see `Dpb::frame_field_pocs`)
    pub(crate) field_poc: [i32; 2],
    pub(crate) nal_unit_type: NalUnitType,
    pub(crate) nal_ref_idc: u8,
    // Per-MB arrays that persist across slices
    pub(crate) nc_luma: Vec<u8>,
    pub(crate) nc_cb: Vec<u8>,
    pub(crate) nc_cr: Vec<u8>,
    pub(crate) mv_store_l0: Vec<[i16; 2]>,
    pub(crate) mv_store_l1: Vec<[i16; 2]>,
    pub(crate) ref_idx_store_l0: Vec<i8>,
    pub(crate) ref_poc_store_l0: Vec<i32>,
    pub(crate) ref_poc_store_l1: Vec<i32>,
    pub(crate) ref_idx_store_l1: Vec<i8>,
    pub(crate) mvd_store: Vec<[i16; 2]>,
    pub(crate) mvd_store_l1: Vec<[i16; 2]>,
    pub(crate) mb_info: Vec<deblock::MbInfo>,
    pub(crate) i4x4_modes: Vec<u8>,
    // CABAC neighbor context state
    pub(crate) mb_cbp: Vec<u16>,
    pub(crate) mb_chroma_pred: Vec<u8>,
    pub(crate) mb_is_8x8dct: Vec<bool>,
    pub(crate) mb_skip: Vec<bool>,
    pub(crate) mb_is_direct: Vec<bool>,
    pub(crate) blk_is_direct: Vec<bool>,
    pub(crate) is_i16x16: Vec<bool>,
    /// Per-MB slice ID for slice boundary detection. MBs from different
    /// slices are treated as unavailable for CABAC context and MV prediction.
    pub(crate) mb_slice_id: Vec<u16>,
    /// Current slice ID counter (incremented for each new slice).
    pub(crate) current_slice_id: u16,
    #[allow(dead_code)]
    pub(crate) prev_mb_qp: i32,
    #[allow(dead_code)]
    pub(crate) last_qp_delta_nonzero: bool,
    // Slice header info for finalization
    pub(crate) mmco_ops: Vec<(u32, u32)>,
    pub(crate) adaptive_ref_pic_marking: bool,
    pub(crate) long_term_reference_flag: bool,
    pub(crate) is_intra_slice: bool,
    /// Deblocking settings of each slice so far, indexed by slice ID
    /// (each MB is filtered as its own slice says, spec 8.7).
    pub(crate) slice_deblock: Vec<deblock::SliceDeblock>,
    pub(crate) chroma_qp_index_offset: i32,
    pub(crate) second_chroma_qp_index_offset: i32,
    pub(crate) mb_width: u32,
    pub(crate) mb_height: u32,
    /// Per-MB-pair field decoding flag (MBAFF only). Indexed by pair address.
    pub(crate) mb_field_decoding: Vec<bool>,
    /// True if this picture uses MBAFF (mb_adaptive_frame_field_flag && !field_pic_flag).
    pub(crate) mbaff_frame_flag: bool,
    /// True if this picture is a field picture (field_pic_flag=1).
    pub(crate) field_pic_flag: bool,
    /// True if this is the bottom field (only valid when field_pic_flag=true).
    pub(crate) bottom_field_flag: bool,
    /// Full frame height (needed for field picture output combining).
    pub(crate) frame_height: u32,
    /// MaxFrameNum from the SPS, for the picture numbers MMCO commands give.
    pub(crate) max_frame_num: u32,
    /// Top-left of the display window in this picture's coded planes, in luma
    /// samples (field lines for field pictures).
    pub(crate) crop_x: u32,
    pub(crate) crop_y: u32,
}

/// verge: of a macroblock that no slice gave yet.
const NO_SLICE: u16 = u16::MAX;

/// Streaming H.264 decoder.
///
/// Feed NAL units one at a time with [`decode_nal`](Self::decode_nal) and
/// receive decoded frames as they become available. Call [`flush`](Self::flush)
/// at end-of-stream to retrieve any final buffered frame.
///
/// Internally maintains parameter set tables (SPS, PPS), a Decoded Picture
/// Buffer (DPB), and any in-progress slice state.
///
/// # Example
///
/// ```no_run
/// use rust_h264::decoder::Decoder;
/// use rust_h264::nal::parse_annex_b;
///
/// let bitstream = std::fs::read("input.h264").unwrap();
/// let nals = parse_annex_b(&bitstream);
/// let mut decoder = Decoder::new();
///
/// for nal in &nals {
///     if let Ok(Some(frame)) = decoder.decode_nal(nal) {
///         println!("Decoded {}x{} frame, POC={}",
///                  frame.width, frame.height, frame.pic_order_cnt);
///     }
/// }
/// if let Some(frame) = decoder.flush() {
///     println!("Final frame, POC={}", frame.pic_order_cnt);
/// }
/// ```
pub struct Decoder {
    sps_table: BTreeMap<u32, Arc<Sps>>,
    pps_table: BTreeMap<u32, Arc<Pps>>,
    dpb: Dpb,
    /// In-progress picture being assembled from one or more slices.
    pending: Option<PictureState>,
    /// First field of a field-picture pair awaiting its complement for output.
    pending_field: Option<Frame>,
    /// The last frame returned came from a picture with MMCO 5, which starts
    /// a new output period (see [`OrderedDecoder`]).
    period_start: bool,
    /// verge: a picture was not given out, for macroblocks were missing.
    incomplete: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// Create a new decoder with empty parameter set tables and DPB.
    pub fn new() -> Self {
        Self {
            sps_table: BTreeMap::new(),
            pps_table: BTreeMap::new(),
            dpb: Dpb::new(0),
            pending: None,
            pending_field: None,
            period_start: false,
            incomplete: false,
        }
    }

    /// verge: whether a picture was not given out since the last call, for
    /// macroblocks of it were missing.
    pub fn take_incomplete(&mut self) -> bool {
        core::mem::take(&mut self.incomplete)
    }

    /// Feed a single NAL unit to the decoder.
    ///
    /// Returns:
    /// - `Ok(Some(frame))` — a decoded frame is ready (in **decode order**;
    ///   sort by `pic_order_cnt` for display order). Note that the returned
    ///   frame belongs to the *previous* picture: when this NAL starts a new
    ///   picture, the decoder finalizes the previous one and returns it.
    /// - `Ok(None)` — the NAL was consumed but no frame is ready yet
    ///   (e.g., SPS, PPS, SEI, or the first slice of a multi-slice picture).
    /// - `Err(e)` — the NAL was malformed or used an unsupported feature.
    ///
    /// Call [`flush`](Self::flush) after the last NAL to retrieve any
    /// remaining buffered frame.
    pub fn decode_nal(&mut self, nal: &NalUnit) -> Result<Option<Frame>, DecodeError> {
        #[cfg(feature = "profile")]
        let _profile_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::DecodeNal);
        match nal.nal_unit_type {
            NalUnitType::Sps | NalUnitType::Pps => {
                store_parameter_set(&mut self.sps_table, &mut self.pps_table, &mut self.dpb, nal)?;
                Ok(None)
            }
            NalUnitType::Sei => Ok(None),
            NalUnitType::SliceIdr | NalUnitType::Slice => {
                // Peek at first_mb_in_slice to detect new vs continuation slice
                let mut peek = BitstreamReader::new(&nal.rbsp);
                let first_mb = peek.read_ue().unwrap_or(0);

                // Check if this is a new picture: first_mb==0 means first
                // slice of a new picture. Continuation slices (first_mb > 0)
                // belong to the same picture even for IDR NALs.
                let is_new_picture = first_mb == 0;

                // Finalize pending frame if a new picture starts
                let prev_frame = if is_new_picture {
                    self.finalize_pending()
                } else {
                    None
                };

                // Decode this slice (creates or continues PictureState).
                // For CAVLC multi-slice, end-of-slice detection may fail,
                // causing errors from reading past the slice boundary. If
                // we had a pending picture, the already-decoded MBs are
                // valid, so we treat the error as end-of-slice.
                //
                // Since decode_slice takes self.pending via take(), we must
                // save a backup for continuation slices so we can restore it
                // if the decode fails mid-slice.
                let had_pending = !is_new_picture && self.pending.is_some();
                let pending_backup = if had_pending {
                    self.pending.clone()
                } else {
                    None
                };
                match self.decode_slice(nal) {
                    Ok(()) => {}
                    // verge: an error is never swallowed. What earlier slices
                    // gave stays pending, and is not given out (see
                    // `finalize_pending`) while macroblocks are missing.
                    Err(e) => {
                        if had_pending {
                            self.pending = pending_backup;
                        }
                        return Err(e);
                    }
                }

                Ok(prev_frame)
            }
            _ => Ok(None),
        }
    }

    /// Finalize any pending picture and return it. Call this after the last
    /// NAL has been fed via [`decode_nal`](Self::decode_nal) to retrieve the
    /// final frame, which is otherwise held internally awaiting a new picture
    /// to trigger its release.
    pub fn flush(&mut self) -> Option<Frame> {
        let frame = self.finalize_pending();
        if frame.is_some() {
            return frame;
        }
        // If a single field is pending (complement never arrived), output it
        // as a half-height frame rather than losing it.
        self.pending_field.take()
    }

    /// Frame rate from the most recently parsed SPS's VUI timing info, as
    /// `(numerator, denominator)`. Returns `None` if no SPS has been parsed
    /// yet, if the SPS does not contain VUI timing info, or if the values
    /// are zero.
    ///
    /// For example, a stream encoded at 29.97 fps would return
    /// `Some((60000, 2002))`. Use [`frame_rate_f64`](Self::frame_rate_f64)
    /// for a single floating-point value.
    pub fn frame_rate(&self) -> Option<(u32, u32)> {
        // Return the first SPS that has timing info. For typical streams
        // there's only one SPS, so this is unambiguous.
        self.sps_table.values().find_map(|s| s.frame_rate())
    }

    /// Frame rate as a single floating-point value. Convenience wrapper
    /// around [`frame_rate`](Self::frame_rate).
    pub fn frame_rate_f64(&self) -> Option<f64> {
        let (n, d) = self.frame_rate()?;
        Some(n as f64 / d as f64)
    }

    /// Finalize the pending picture: apply deblocking, insert into DPB, return frame.
    fn finalize_pending(&mut self) -> Option<Frame> {
        let mut ps = self.pending.take()?;
        // verge: a picture with macroblocks that no slice gave is not given out.
        if !ps.field_pic_flag && ps.mb_slice_id.contains(&NO_SLICE) {
            self.incomplete = true;
            return None;
        }
        deblock_picture(&mut ps);
        {
            #[cfg(feature = "profile")]
            let _profile_timer =
                crate::profile::PhaseTimer::start(crate::profile::Phase::DpbFinalize);
            let pic = Arc::new(make_decoded_picture(&mut ps));
            apply_reference_marking(
                &mut self.dpb,
                pic,
                ps.nal_unit_type,
                ps.nal_ref_idc,
                ps.frame_num,
                ps.max_frame_num,
                ps.field_pic_flag,
                &ps.mmco_ops,
                ps.adaptive_ref_pic_marking,
                ps.long_term_reference_flag,
            );
        }
        let mmco5 = has_mmco5(&ps.mmco_ops);
        let frame = finish_output(ps, &mut self.pending_field);
        self.period_start = mmco5 && frame.is_some();
        frame
    }

    /// Whether the frame just returned starts a new output period (its
    /// picture had MMCO 5), clearing the flag.
    pub(crate) fn take_period_start(&mut self) -> bool {
        core::mem::take(&mut self.period_start)
    }

    fn decode_slice(&mut self, nal: &NalUnit) -> Result<(), DecodeError> {
        let plan = prepare_slice(&self.sps_table, &self.pps_table, &mut self.dpb, nal)?;
        let pending = self.pending.take();
        let ps = run_slice(&plan, pending, None)?;
        self.pending = Some(ps);
        Ok(())
    }
}

/// Reject sequences this decoder cannot decode correctly. Only 8- and
/// 10-bit 4:2:0, 4:2:2 and 4:0:0 with the normal transform path are
/// implemented; anything else would decode
/// to wrong pictures instead of failing. Checked when a slice activates its
/// SPS (not when the SPS is parsed), so streams that merely carry such an
/// SPS still decode, and [`parse_sps_info`](crate::nal::parse_sps_info)
/// can still describe it.
pub(crate) fn check_supported(sps: &Sps) -> Result<(), DecodeError> {
    match sps.chroma_format_idc {
        0..=2 => {}
        3 => return Err(DecodeError::Unsupported("4:4:4 chroma")),
        _ => return Err(DecodeError::InvalidSyntax("chroma_format_idc out of range")),
    }
    // 8 and 10 bits; chroma (when present) at the luma depth, as FFmpeg
    if !matches!(sps.bit_depth_luma_minus8, 0 | 2) {
        return Err(DecodeError::Unsupported("bit depth other than 8 or 10"));
    }
    if sps.chroma_format_idc != 0 && sps.bit_depth_chroma_minus8 != sps.bit_depth_luma_minus8 {
        return Err(DecodeError::Unsupported(
            "different luma and chroma bit depths",
        ));
    }
    if sps.qpprime_y_zero_transform_bypass_flag {
        return Err(DecodeError::Unsupported(
            "lossless (transform bypass) coding",
        ));
    }
    Ok(())
}

/// Parse an SPS or PPS NAL and store it in the parameter-set tables. An SPS
/// also updates the DPB's reference frame capacity.
pub(crate) fn store_parameter_set(
    sps_table: &mut BTreeMap<u32, Arc<Sps>>,
    pps_table: &mut BTreeMap<u32, Arc<Pps>>,
    dpb: &mut Dpb,
    nal: &NalUnit,
) -> Result<(), DecodeError> {
    match nal.nal_unit_type {
        NalUnitType::Sps => {
            let sps = parse_sps(&nal.rbsp)?;
            dpb.set_max_ref_frames(sps.max_num_ref_frames);
            sps_table.insert(sps.seq_parameter_set_id, Arc::new(sps));
        }
        NalUnitType::Pps => {
            let pps_id_sps = {
                // Peek at seq_parameter_set_id to find the right SPS
                let mut peek = BitstreamReader::new(&nal.rbsp);
                let _ = peek.read_ue(); // pic_parameter_set_id
                peek.read_ue().ok()
            };
            let sps_ref = pps_id_sps.and_then(|id| sps_table.get(&id)).map(|s| &**s);
            let pps = parse_pps(&nal.rbsp, sps_ref)?;
            pps_table.insert(pps.pic_parameter_set_id, Arc::new(pps));
        }
        _ => {}
    }
    Ok(())
}

/// Everything about one slice that can be decided from its header and the
/// DPB state alone: the parsed header, parameter sets, reference lists and
/// weights, picture geometry, and the slice data to decode. Building a plan
/// is cheap and mutates only the DPB's POC state; running it does the
/// macroblock decode. The split lets the threaded decoder plan slices in
/// coded order on one thread and run them on others.
pub(crate) struct SlicePlan {
    pub(crate) sps: Arc<Sps>,
    pub(crate) pps: Arc<Pps>,
    pub(crate) header: SliceHeader,
    pub(crate) nal_unit_type: NalUnitType,
    pub(crate) nal_ref_idc: u8,
    /// Slice RBSP (header + data); the MB loop resumes at `header_end`.
    pub(crate) rbsp: Vec<u8>,
    pub(crate) header_end: (usize, u8),
    pub(crate) current_poc: i32,
    pub(crate) ref_pic_list: Vec<Arc<DecodedPicture>>,
    pub(crate) ref_pic_list_l0: Vec<Arc<DecodedPicture>>,
    pub(crate) ref_pic_list_l1: Vec<Arc<DecodedPicture>>,
    /// Which entries of the B-slice lists are long-term references
    pub(crate) long_term_l0: Vec<bool>,
    pub(crate) long_term_l1: Vec<bool>,
    pub(crate) use_weight: u8,
    pub(crate) implicit_weights: Vec<Vec<i32>>,
    /// MBAFF implicit weights for field MBs, per MB parity (0 = top), indexed
    /// by field ref_idx: `[parity][l0][l1]` = L0 weight
    pub(crate) implicit_weights_field: [Vec<Vec<i32>>; 2],
    /// Top and bottom field POCs of the current picture
    pub(crate) field_poc: [i32; 2],
    pub(crate) slice_qp: i32,
    pub(crate) width: u32,
    pub(crate) frame_height: u32,
    pub(crate) height: u32,
    pub(crate) mb_width: u32,
    pub(crate) mb_height: u32,
    pub(crate) coded_width: u32,
    pub(crate) coded_height: u32,
    pub(crate) total_mbs: usize,
    /// Display window origin in this picture's coded planes (luma samples;
    /// field lines for field pictures).
    pub(crate) crop_x: u32,
    pub(crate) crop_y: u32,
}

/// Header-level half of slice decoding (see [`SlicePlan`]).
pub(crate) fn prepare_slice(
    sps_table: &BTreeMap<u32, Arc<Sps>>,
    pps_table: &BTreeMap<u32, Arc<Pps>>,
    dpb: &mut Dpb,
    nal: &NalUnit,
) -> Result<SlicePlan, DecodeError> {
    #[cfg(feature = "profile")]
    let _setup_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::SliceSetup);
    // The slice header starts with first_mb_in_slice, slice_type and
    // pic_parameter_set_id; the rest of it depends on that PPS
    let pps_id = {
        let mut peek = BitstreamReader::new(&nal.rbsp);
        peek.read_ue()?;
        peek.read_ue()?;
        peek.read_ue()?
    };
    let pps = pps_table
        .get(&pps_id)
        .ok_or(DecodeError::InvalidSyntax("no PPS available"))?;
    let sps = sps_table
        .get(&pps.seq_parameter_set_id)
        .ok_or(DecodeError::InvalidSyntax("no SPS available"))?;
    check_supported(sps)?;

    let (header, reader) =
        parse_slice_header(&nal.rbsp, sps, pps, nal.nal_unit_type, nal.nal_ref_idc)?;

    if header.slice_type != SliceType::I
        && header.slice_type != SliceType::P
        && header.slice_type != SliceType::B
    {
        return Err(DecodeError::from("unsupported slice type"));
    }
    let is_field_pic = header.field_pic_flag;
    let is_p_slice = header.slice_type == SliceType::P;
    let is_b_slice = header.slice_type == SliceType::B;

    // Compute POC for current picture (needed for B-slice ref list construction)
    let current_poc = dpb.compute_poc(sps, &header, nal.nal_unit_type, nal.nal_ref_idc);

    // Build reference picture lists
    // For field pictures: MaxPicNum = 2*MaxFrameNum, CurrPicNum = 2*frame_num+1
    let max_frame_num = 1u32 << (sps.log2_max_frame_num_minus4 + 4).min(31);
    let max_pic_num = if is_field_pic {
        max_frame_num.saturating_mul(2)
    } else {
        max_frame_num
    };
    let curr_pic_num = if is_field_pic {
        header.frame_num.saturating_mul(2).saturating_add(1)
    } else {
        header.frame_num
    };
    // Skipped frame_num values become "non-existing" reference frames
    // (spec 8.2.5.2); later slices of the picture find no gap left
    if nal.nal_unit_type != NalUnitType::SliceIdr {
        dpb.fill_frame_num_gap(header.frame_num, max_frame_num);
    }
    let mut ref_pic_list = if is_p_slice {
        let mut refs = dpb.short_term_ref_list(
            header.frame_num,
            max_frame_num,
            is_field_pic,
            header.bottom_field_flag,
        );
        // Pad ref list if shorter than num_ref_idx_l0_active (spec 8.2.4.2.1:
        // if the list is shorter, duplicate the last entry to fill)
        if !refs.is_empty() {
            while refs.len() < header.num_ref_idx_l0_active as usize {
                refs.push(refs.last().unwrap().clone());
            }
        }
        refs
    } else {
        vec![]
    };
    let mut _ref_pic_list_l0 = if is_b_slice {
        let mut refs = dpb.ref_list_l0_b(current_poc, is_field_pic, header.bottom_field_flag);
        if !refs.is_empty() {
            while refs.len() < header.num_ref_idx_l0_active as usize {
                refs.push(refs.last().unwrap().clone());
            }
        }
        refs
    } else {
        vec![]
    };
    let mut _ref_pic_list_l1 = if is_b_slice {
        let mut refs = dpb.ref_list_l1_b(current_poc, is_field_pic, header.bottom_field_flag);
        if !refs.is_empty() {
            while refs.len() < header.num_ref_idx_l1_active as usize {
                refs.push(refs.last().unwrap().clone());
            }
        }
        refs
    } else {
        vec![]
    };

    // The initial lists keep only their first num_ref_idx_lX_active entries
    // (spec 8.2.4.2); modification works on lists of that length.
    ref_pic_list.truncate(header.num_ref_idx_l0_active as usize);
    _ref_pic_list_l0.truncate(header.num_ref_idx_l0_active as usize);
    _ref_pic_list_l1.truncate(header.num_ref_idx_l1_active as usize);

    // Apply ref_pic_list_modification (spec 8.2.4.3)
    // A command may name any short-term reference, not only one in the list.
    let short_term = dpb.short_term_refs(is_field_pic);
    let long_term = dpb.long_term_refs(is_field_pic);
    if is_p_slice && !header.ref_list_mod_l0.is_empty() {
        Dpb::apply_ref_list_modification(
            &mut ref_pic_list,
            &header.ref_list_mod_l0,
            curr_pic_num,
            max_pic_num,
            is_field_pic,
            header.bottom_field_flag,
            &short_term,
            &long_term,
        );
    }
    if is_b_slice && !header.ref_list_mod_l0.is_empty() {
        Dpb::apply_ref_list_modification(
            &mut _ref_pic_list_l0,
            &header.ref_list_mod_l0,
            curr_pic_num,
            max_pic_num,
            is_field_pic,
            header.bottom_field_flag,
            &short_term,
            &long_term,
        );
    }
    if is_b_slice && !header.ref_list_mod_l1.is_empty() {
        Dpb::apply_ref_list_modification(
            &mut _ref_pic_list_l1,
            &header.ref_list_mod_l1,
            curr_pic_num,
            max_pic_num,
            is_field_pic,
            header.bottom_field_flag,
            &short_term,
            &long_term,
        );
    }

    let is_long_term = |list: &[Arc<DecodedPicture>]| -> Vec<bool> {
        list.iter()
            .map(|p| long_term.iter().any(|(q, _)| Arc::ptr_eq(p, q)))
            .collect()
    };
    let long_term_l0 = is_long_term(&_ref_pic_list_l0);
    let long_term_l1 = is_long_term(&_ref_pic_list_l1);

    // Weighted prediction mode:
    // 0 = no weighting (default)
    // 1 = explicit weights (P-slice weighted_pred_flag=1, or B-slice weighted_bipred_idc=1)
    // 2 = implicit weights (B-slice weighted_bipred_idc=2)
    let use_weight =
        if (is_p_slice && pps.weighted_pred_flag) || (is_b_slice && pps.weighted_bipred_idc == 1) {
            1
        } else if is_b_slice && pps.weighted_bipred_idc == 2 {
            2
        } else {
            0
        };

    // Implicit weighted prediction: compute L0 weight from POC distances.
    // implicit_weights[l0_idx][l1_idx] = w0. L1 weight = 64 - w0. Fixed log2_denom=5.
    let implicit_weight = |cur: i32, poc0: i32, poc1: i32| {
        let td = (poc1 - poc0).clamp(-128, 127);
        if td == 0 {
            32
        } else {
            let tb = (cur - poc0).clamp(-128, 127);
            let tx = (16384 + (td.abs() / 2)) / td;
            let w1 = (tb * tx + 32) >> 8;
            if !(-64..=128).contains(&w1) {
                32
            } else {
                64 - w1
            }
        }
    };
    let implicit_weights: Vec<Vec<i32>> = if use_weight == 2 {
        // A long-term reference gets the default weight (spec 8.4.2.3.1)
        _ref_pic_list_l0
            .iter()
            .zip(&long_term_l0)
            .map(|(ref_l0, &lt0)| {
                _ref_pic_list_l1
                    .iter()
                    .zip(&long_term_l1)
                    .map(|(ref_l1, &lt1)| {
                        if lt0 || lt1 {
                            32
                        } else {
                            implicit_weight(current_poc, ref_l0.pic_order_cnt, ref_l1.pic_order_cnt)
                        }
                    })
                    .collect()
            })
            .collect()
    } else {
        vec![]
    };
    let field_poc = Dpb::frame_field_pocs(sps, &header, current_poc);
    // MBAFF field MBs predict from fields: field ref_idx k of an MB of parity
    // p is the field of parity p ^ (k & 1) of frame entry k / 2, and the
    // implicit weights use field POCs (spec 8.4.2.3.1).
    let implicit_weights_field: [Vec<Vec<i32>>; 2] = if use_weight == 2 && header.mbaff_frame_flag {
        let field_ref_poc =
            |list: &[Arc<DecodedPicture>], p: usize, k: usize| list[k / 2].field_poc[p ^ (k & 1)];
        [0, 1].map(|p| {
            (0.._ref_pic_list_l0.len() * 2)
                .map(|k0| {
                    (0.._ref_pic_list_l1.len() * 2)
                        .map(|k1| {
                            if long_term_l0[k0 / 2] || long_term_l1[k1 / 2] {
                                return 32;
                            }
                            implicit_weight(
                                field_poc[p],
                                field_ref_poc(&_ref_pic_list_l0, p, k0),
                                field_ref_poc(&_ref_pic_list_l1, p, k1),
                            )
                        })
                        .collect()
                })
                .collect()
        })
    } else {
        [vec![], vec![]]
    };

    // The coded size comes from the SPS macroblock counts (spec 7.4.2.1.1);
    // the display size is that minus the cropping, which may remove a
    // macroblock or more, so it cannot be used to derive the MB counts.
    let width = sps.width();
    let frame_height = sps.height();
    let mb_width = sps.pic_width_in_mbs_minus1.saturating_add(1);
    let map_units = sps.pic_height_in_map_units_minus1.saturating_add(1);
    let frame_mb_height = if sps.frame_mbs_only_flag {
        map_units
    } else {
        map_units.saturating_mul(2)
    };
    // Reject absurd dimensions that would cause allocation overflow, and
    // cropping that removes the whole picture (the display size saturates to
    // 0). H.264 Level 6.2 max is 8192x4320; allow up to 16384x16384.
    if width == 0 || frame_height == 0 || mb_width > 16384 / 16 || frame_mb_height > 16384 / 16 {
        return Err(DecodeError::InvalidSyntax("SPS dimensions out of range"));
    }
    // For field pictures, each field has half the frame height
    let (height, mb_height) = if is_field_pic {
        (frame_height / 2, frame_mb_height / 2)
    } else {
        (frame_height, frame_mb_height)
    };
    let coded_width = mb_width * 16;
    let coded_height = mb_height * 16;
    let total_mbs = (mb_width * mb_height) as usize;
    // Display window origin. The top offset is in frame lines, so a field
    // picture starts half as many of its own lines down.
    let crop_x = sps.crop_left();
    let crop_y = if is_field_pic {
        sps.crop_top() / 2
    } else {
        sps.crop_top()
    };

    let slice_qp = header.qp_y(pps);

    Ok(SlicePlan {
        sps: Arc::clone(sps),
        pps: Arc::clone(pps),
        header_end: reader.position(),
        header,
        nal_unit_type: nal.nal_unit_type,
        nal_ref_idc: nal.nal_ref_idc,
        rbsp: nal.rbsp.to_vec(),
        current_poc,
        ref_pic_list,
        ref_pic_list_l0: _ref_pic_list_l0,
        ref_pic_list_l1: _ref_pic_list_l1,
        long_term_l0,
        long_term_l1,
        use_weight,
        implicit_weights,
        implicit_weights_field,
        field_poc,
        slice_qp,
        width,
        frame_height,
        height,
        mb_width,
        mb_height,
        coded_width,
        coded_height,
        total_mbs,
        crop_x,
        crop_y,
    })
}

/// Macroblock-decode half of slice decoding: creates or continues the
/// picture's [`PictureState`] (`pending` is the state left by an earlier
/// slice of the same picture) and decodes all macroblocks of the slice.
/// Returns the updated state; deblocking and DPB insertion happen when the
/// picture is finalized.
pub(crate) fn run_slice(
    plan: &SlicePlan,
    pending: Option<PictureState>,
    sync: Option<&mut RowSync>,
) -> Result<PictureState, DecodeError> {
    // The slice decoder is compiled once per sample type
    if plan.sps.bit_depth_luma_minus8 == 2 {
        run_slice_px::<u16>(plan, pending, sync)
    } else {
        run_slice_px::<u8>(plan, pending, sync)
    }
}

/// [`run_slice`] for samples of type `P`.
fn run_slice_px<P: Pixel>(
    plan: &SlicePlan,
    mut pending: Option<PictureState>,
    mut sync: Option<&mut RowSync>,
) -> Result<PictureState, DecodeError> {
    // Covers everything before the MB loop: PictureState allocation and
    // entropy decoder init.
    #[cfg(feature = "profile")]
    let setup_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::SliceSetup);
    let header = &plan.header;
    let sps: &Sps = &plan.sps;
    let pps: &Pps = &plan.pps;
    let rbsp: &[u8] = &plan.rbsp;
    let mut reader = BitstreamReader::new(rbsp);
    reader.set_position(plan.header_end);
    let is_field_pic = header.field_pic_flag;
    let is_p_slice = header.slice_type == SliceType::P;
    let is_b_slice = header.slice_type == SliceType::B;
    let current_poc = plan.current_poc;
    let ref_pic_list: &[Arc<DecodedPicture>] = &plan.ref_pic_list;
    let _ref_pic_list_l0: &[Arc<DecodedPicture>] = &plan.ref_pic_list_l0;
    let _ref_pic_list_l1: &[Arc<DecodedPicture>] = &plan.ref_pic_list_l1;
    let use_weight = plan.use_weight;
    let implicit_weights = &plan.implicit_weights;
    let implicit_weights_field = &plan.implicit_weights_field;
    let (width, frame_height, height) = (plan.width, plan.frame_height, plan.height);
    let (mb_width, mb_height) = (plan.mb_width, plan.mb_height);
    let (coded_width, coded_height) = (plan.coded_width, plan.coded_height);
    let total_mbs = plan.total_mbs;
    let slice_qp = plan.slice_qp;
    let wctx = WeightContext {
        use_weight,
        wt: header.weight_table.as_ref(),
        implicit_weights,
        implicit_weights_field,
    };

    // Create or reuse PictureState for multi-slice support.
    // For continuation slices (first_mb > 0), reuse the pending state
    // so per-MB data from earlier slices is visible for MV prediction,
    // CABAC neighbor contexts, and deblocking.
    let is_continuation = header.first_mb_in_slice > 0
        && pending.is_some()
        && pending.as_ref().unwrap().mb_slice_id.len() == total_mbs;
    let ps = if is_continuation {
        pending.take().unwrap()
    } else {
        let chroma_format = ChromaFormat::from_idc(sps.chroma_format_idc);
        let chroma_len =
            ((coded_width / 2) * (coded_height >> chroma_format.shift_y())) as usize * P::BYTES;
        PictureState {
            frame: Frame {
                width,
                height,
                y: vec![0u8; (coded_width * coded_height) as usize * P::BYTES],
                u: vec![0u8; chroma_len],
                v: vec![0u8; chroma_len],
                pic_order_cnt: current_poc,
                chroma_format,
                bit_depth: P::BIT_DEPTH as u8,
            },
            frame_num: header.frame_num,
            poc: current_poc,
            field_poc: plan.field_poc,
            nal_unit_type: plan.nal_unit_type,
            nal_ref_idc: plan.nal_ref_idc,
            nc_luma: vec![0u8; total_mbs * 16],
            nc_cb: vec![0u8; total_mbs * 8],
            nc_cr: vec![0u8; total_mbs * 8],
            mv_store_l0: vec![[0i16; 2]; total_mbs * 16],
            mv_store_l1: vec![[0i16; 2]; total_mbs * 16],
            ref_idx_store_l0: vec![-1i8; total_mbs * 16],
            ref_poc_store_l0: vec![-1i32; total_mbs * 16],
            ref_poc_store_l1: vec![-1i32; total_mbs * 16],
            ref_idx_store_l1: vec![-1i8; total_mbs * 16],
            mvd_store: vec![[0i16; 2]; total_mbs * 16],
            mvd_store_l1: vec![[0i16; 2]; total_mbs * 16],
            mb_info: vec![deblock::MbInfo::default(); total_mbs],
            i4x4_modes: vec![2u8; total_mbs * 16],
            mb_cbp: vec![0u16; total_mbs],
            mb_chroma_pred: vec![0u8; total_mbs],
            mb_is_8x8dct: vec![false; total_mbs],
            mb_skip: vec![false; total_mbs],
            mb_is_direct: vec![false; total_mbs],
            blk_is_direct: vec![false; total_mbs * 16],
            is_i16x16: vec![false; total_mbs],
            mb_slice_id: vec![NO_SLICE; total_mbs],
            current_slice_id: 0,
            prev_mb_qp: slice_qp,
            last_qp_delta_nonzero: false,
            mmco_ops: header.mmco_ops.clone(),
            adaptive_ref_pic_marking: header.adaptive_ref_pic_marking,
            long_term_reference_flag: header.long_term_reference_flag,
            is_intra_slice: header.slice_type == SliceType::I,
            slice_deblock: Vec::new(),
            chroma_qp_index_offset: pps.chroma_qp_index_offset,
            second_chroma_qp_index_offset: pps.second_chroma_qp_index_offset,
            mb_width,
            mb_height,
            mb_field_decoding: vec![false; total_mbs.div_ceil(2)],
            mbaff_frame_flag: header.mbaff_frame_flag,
            field_pic_flag: header.field_pic_flag,
            bottom_field_flag: header.bottom_field_flag,
            frame_height,
            max_frame_num: 1u32 << (sps.log2_max_frame_num_minus4 + 4).min(31),
            crop_x: plan.crop_x,
            crop_y: plan.crop_y,
        }
    };

    // Destructure into local variables so existing code works unchanged
    let PictureState {
        mut frame,
        frame_num: _ps_frame_num,
        poc: _ps_poc,
        field_poc: ps_field_poc,
        nal_unit_type: _ps_nal_type,
        nal_ref_idc: _ps_nal_ref_idc,
        mut nc_luma,
        mut nc_cb,
        mut nc_cr,
        mut mv_store_l0,
        mut mv_store_l1,
        mut ref_idx_store_l0,
        mut ref_poc_store_l0,
        mut ref_poc_store_l1,
        mut ref_idx_store_l1,
        mut mvd_store,
        mut mvd_store_l1,
        mut mb_info,
        mut i4x4_modes,
        mut mb_cbp,
        mut mb_chroma_pred,
        mut mb_is_8x8dct,
        mut mb_skip,
        mut mb_is_direct,
        mut blk_is_direct,
        mut is_i16x16,
        mut mb_slice_id,
        mut current_slice_id,
        prev_mb_qp: _,
        last_qp_delta_nonzero: _,
        mmco_ops: _ps_mmco_ops,
        adaptive_ref_pic_marking: _,
        long_term_reference_flag: _ps_lt_ref_flag,
        is_intra_slice: _ps_is_intra,
        mut slice_deblock,
        chroma_qp_index_offset: ps_chroma_qp_offset,
        second_chroma_qp_index_offset: ps_second_chroma_qp_offset,
        mb_width: _ps_mb_width,
        mb_height: _ps_mb_height,
        mb_field_decoding: mut _mb_field_decoding,
        mbaff_frame_flag: _ps_mbaff,
        field_pic_flag: _ps_field,
        bottom_field_flag: _ps_bottom,
        frame_height: _ps_frame_height,
        max_frame_num,
        crop_x,
        crop_y,
    } = ps;

    // Increment slice ID for continuation slices so boundary checks work
    if is_continuation {
        current_slice_id += 1;
    }
    let this_slice_id = current_slice_id;

    // This slice's deblocking settings, at its ID
    let this_slice_deblock = deblock::SliceDeblock {
        disable_deblocking_filter_idc: header.disable_deblocking_filter_idc,
        slice_alpha_c0_offset_div2: header.slice_alpha_c0_offset_div2,
        slice_beta_offset_div2: header.slice_beta_offset_div2,
    };
    slice_deblock.resize(usize::from(this_slice_id), this_slice_deblock);
    slice_deblock.push(this_slice_deblock);

    // Each slice reinitializes its own QP from the slice header
    let mut prev_mb_qp = slice_qp;
    let mut last_qp_delta_nonzero = false;

    // CABAC or CAVLC?
    let use_cabac = pps.entropy_coding_mode_flag;

    // Initialize CABAC engine if needed
    let cabac_byte_pos = if use_cabac {
        let (pos, _data) = reader.cabac_start();
        Some(pos)
    } else {
        None
    };
    // Create CabacReader from original RBSP data (avoids borrow conflict with reader)
    let mut cabac_reader = cabac_byte_pos.map(|pos| crate::cabac::CabacReader::new(rbsp, pos));
    let mut cabac_state = if use_cabac {
        crate::cabac::init_cabac_states(
            slice_qp,
            header.slice_type == SliceType::I,
            header.cabac_init_idc,
        )
    } else {
        [0u8; 1024]
    };

    let mut mb_skip_run: i32 = -1; // -1 = not initialized for P slices
    let mut mbaff_skip_lookahead: Option<bool> = None;

    let stride = coded_width as usize;
    let mbaff = header.mbaff_frame_flag;
    let mut mb_ly_stride = stride;
    let mut mb_ly_offset = 0usize;
    let mut mb_lc_stride = (coded_width / 2) as usize;
    let mut mb_lc_offset = 0usize;

    // Macro to construct a SliceContext from the local variables.
    // Used at each call site that delegates to a SliceContext method.
    macro_rules! make_ctx {
        () => {
            SliceContext {
                _pixel: core::marker::PhantomData::<P>,
                frame: &mut frame,
                stride,
                width: coded_width,
                height: coded_height,
                mb_width,
                nc_luma: &mut nc_luma,
                nc_cb: &mut nc_cb,
                nc_cr: &mut nc_cr,
                mv_store_l0: &mut mv_store_l0,
                mv_store_l1: &mut mv_store_l1,
                ref_idx_store_l0: &mut ref_idx_store_l0,
                ref_poc_store_l0: &mut ref_poc_store_l0,
                ref_poc_store_l1: &mut ref_poc_store_l1,
                ref_idx_store_l1: &mut ref_idx_store_l1,
                mvd_store: &mut mvd_store,
                mvd_store_l1: &mut mvd_store_l1,
                mb_info: &mut mb_info,
                i4x4_modes: &mut i4x4_modes,
                mb_cbp: &mut mb_cbp,
                mb_chroma_pred: &mut mb_chroma_pred,
                mb_is_8x8dct: &mut mb_is_8x8dct,
                mb_skip: &mut mb_skip,
                mbaff_skip_lookahead: &mut mbaff_skip_lookahead,
                mb_is_direct: &mut mb_is_direct,
                blk_is_direct: &mut blk_is_direct,
                is_i16x16: &mut is_i16x16,
                mb_slice_id: &mut mb_slice_id,
                this_slice_id,
                prev_mb_qp,
                last_qp_delta_nonzero,
                mbaff,
                mb_field_decoding: &mut _mb_field_decoding,
                ly_stride: mb_ly_stride,
                ly_offset: mb_ly_offset,
                lc_stride: mb_lc_stride,
                lc_offset: mb_lc_offset,
                field_pic_flag: is_field_pic,
                bottom_field_flag: header.bottom_field_flag,
            }
        };
    }

    let params = SliceParams {
        is_p_slice,
        is_b_slice,
        use_weight,
        current_poc,
        current_field_poc: plan.field_poc,
        direct_spatial_mv_pred_flag: header.direct_spatial_mv_pred_flag,
        direct_8x8_inference_flag: sps.direct_8x8_inference_flag,
        transform_8x8_mode_flag: pps.transform_8x8_mode_flag,
        scaling_list_4x4: &pps.scaling_list_4x4,
        scaling_list_8x8: &pps.scaling_list_8x8,
        constrained_intra_pred_flag: pps.constrained_intra_pred_flag,
        chroma_qp_index_offset: pps.chroma_qp_index_offset,
        second_chroma_qp_index_offset: pps.second_chroma_qp_index_offset,
        monochrome: sps.chroma_format_idc == 0,
        ref_pic_list,
        ref_pic_list_l0: _ref_pic_list_l0,
        ref_pic_list_l1: _ref_pic_list_l1,
        long_term_l0: &plan.long_term_l0,
        long_term_l1: &plan.long_term_l1,
        num_ref_idx_l0_active: header.num_ref_idx_l0_active,
        num_ref_idx_l1_active: header.num_ref_idx_l1_active,
        wctx: &wctx,
        first_mb_in_slice: header.first_mb_in_slice,
        slice_qp,
        is_i_slice: header.slice_type == SliceType::I,
        cabac_init_idc: header.cabac_init_idc,
    };

    // In MBAFF, first_mb_in_slice is a pair address
    let mut mb_idx = if mbaff {
        (header.first_mb_in_slice as usize) * 2
    } else {
        header.first_mb_in_slice as usize
    };
    if mb_idx >= total_mbs {
        return Err(DecodeError::InvalidSyntax("first_mb_in_slice out of range"));
    }
    #[cfg(feature = "profile")]
    drop(setup_timer);
    #[cfg(feature = "profile")]
    let loop_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::MbLoop);
    // MBs of this slice from `fin_from` on still need their deblocking info
    // filled in (finalize_mb_info_range).
    let mut fin_from = mb_idx;
    let mut cabac_ended = false;
    let slice_first_mb = mb_idx;
    let unit_len = deblock_unit_len(mb_width as usize, mbaff);
    while mb_idx < total_mbs {
        // Frame threading: deblock and publish rows as they become final.
        if let Some(sync) = sync.as_mut() {
            let ready = sync.ready_mb(mb_idx, unit_len);
            if ready >= (sync.next_unit + 2) * unit_len {
                if ready > fin_from {
                    make_ctx!().finalize_mb_info_range(fin_from, ready, &params);
                    fin_from = ready;
                }
                sync.advance(
                    ready,
                    &mut frame,
                    &mb_info,
                    mb_width as usize,
                    deblock::Interlace {
                        mbaff_field: mbaff.then_some(&_mb_field_decoding[..]),
                        field_pic: header.field_pic_flag,
                    },
                    &mb_slice_id,
                    &slice_deblock,
                    ps_chroma_qp_offset,
                    ps_second_chroma_qp_offset,
                );
            }
        }
        // CAVLC end-of-slice: check before reading any new syntax elements.
        // Skip this check when counting down a skip run (no reads needed).
        if !use_cabac && mb_skip_run <= 0 && !reader.more_rbsp_data() {
            break;
        }

        // Stamp this MB with the current slice ID for boundary detection
        mb_slice_id[mb_idx] = this_slice_id;
        // MBAFF: a pair's mb_field_decoding_flag defaults to the inferred
        // value (spec 7.4.4: left pair in the same slice, else the pair
        // above, else frame). It is used as is when neither MB of the pair
        // carries the flag, and for context derivation until it is decoded.
        if mbaff && mb_idx.is_multiple_of(2) {
            let pair = mb_idx / 2;
            let mbw = mb_width as usize;
            _mb_field_decoding[pair] =
                if !pair.is_multiple_of(mbw) && mb_slice_id[mb_idx - 2] == this_slice_id {
                    _mb_field_decoding[pair - 1]
                } else if pair >= mbw && mb_slice_id[mb_idx - 2 * mbw] == this_slice_id {
                    _mb_field_decoding[pair - mbw]
                } else {
                    false
                };
        }
        // Compute pixel position
        let (mb_x, mb_y) = if mbaff {
            let pair_addr = mb_idx / 2;
            let pair_col = pair_addr % mb_width as usize;
            let pair_row = pair_addr / mb_width as usize;
            let x = pair_col * 16;
            let y = pair_row * 32 + (mb_idx % 2) * 16;
            (x, y)
        } else {
            (
                (mb_idx % mb_width as usize) * 16,
                (mb_idx / mb_width as usize) * 16,
            )
        };

        // CABAC decode path
        if use_cabac {
            let cr = cabac_reader.as_mut().unwrap();
            let st = &mut cabac_state;

            // MBAFF: end_of_slice_flag and mb_field_decoding_flag are both
            // handled inside decode_cabac_mb (contexts 70-72 for field flag,
            // with MBAFF-adjusted first_mb comparison for terminate).
            {
                #[cfg(feature = "profile")]
                let _profile_timer =
                    crate::profile::PhaseTimer::start(crate::profile::Phase::MbDecode);
                let mut ctx = make_ctx!();
                match ctx.decode_cabac_mb(cr, st, rbsp, mb_idx, mb_x, mb_y, &params)? {
                    CabacMbResult::EndOfSlice => {
                        // verge: this macroblock is not of this slice.
                        mb_slice_id[mb_idx] = NO_SLICE;
                        cabac_ended = true;
                        break;
                    }
                    CabacMbResult::Decoded => {}
                }
                prev_mb_qp = ctx.prev_mb_qp;
                last_qp_delta_nonzero = ctx.last_qp_delta_nonzero;
            }
            if mbaff && mb_idx % 2 != 0 {
                let term = cr.get_cabac_terminate();
                if term != 0 {
                    mb_idx += 1;
                    cabac_ended = true;
                    break;
                }
            }

            mb_idx += 1;
            continue;
        }

        // P/B-slice skip run handling
        if is_p_slice || is_b_slice {
            if mb_skip_run < 0 {
                mb_skip_run = reader.read_ue()? as i32;
            }
            if mb_skip_run > 0 {
                mb_skip_run -= 1;
                mb_skip[mb_idx] = true; // Mark as skipped for MBAFF field flag inference
                                        // MBAFF: when a run ends on a skipped top MB, the bottom MB is
                                        // coded and its mb_field_decoding_flag (the next bit) applies
                                        // to the whole pair, so read it before decoding this MB.
                if mbaff && mb_idx.is_multiple_of(2) && mb_skip_run == 0 {
                    _mb_field_decoding[mb_idx / 2] = reader.read_bit()? != 0;
                }
                // Set layout for skip MBs (field_flag already known)
                {
                    let mut ctx = make_ctx!();
                    ctx.set_mb_layout(mb_idx, mb_x, mb_y);
                    mb_ly_stride = ctx.ly_stride;
                    mb_ly_offset = ctx.ly_offset;
                    mb_lc_stride = ctx.lc_stride;
                    mb_lc_offset = ctx.lc_offset;
                }
                if is_p_slice {
                    // P_Skip: MV = median predictor, ref_idx = 0, no residual
                    #[cfg(feature = "profile")]
                    let _profile_timer =
                        crate::profile::PhaseTimer::start(crate::profile::Phase::MbDecode);
                    make_ctx!().decode_p_skip_mb(mb_idx, mb_x, mb_y, &params);
                } else {
                    // B_Skip: spatial/temporal direct MV + MC, no residual
                    #[cfg(feature = "profile")]
                    let _profile_timer =
                        crate::profile::PhaseTimer::start(crate::profile::Phase::MbDecode);
                    make_ctx!().decode_b_skip_mb(mb_idx, mb_x, mb_y, &params);
                }
                mb_info[mb_idx] = MbInfo {
                    mb_type: MbType::Inter,
                    qp_y: prev_mb_qp,
                    ..Default::default()
                };
                mb_idx += 1;
                continue;
            }
            // mb_skip_run == 0: parse the next MB normally
            mb_skip_run = -1; // reset for next iteration

            // MBAFF: read mb_field_decoding_flag for this pair
            // (spec 7.3.4: read before first non-skipped MB of pair)
            if mbaff {
                // A bottom MB after a skipped top MB had its flag read with
                // the top MB (above), so only top MBs read it here.
                if mb_idx.is_multiple_of(2) {
                    _mb_field_decoding[mb_idx / 2] = reader.read_bit()? != 0;
                }
            }
        }

        // MBAFF I-slice: read mb_field_decoding_flag before MB decode
        if mbaff && !(is_p_slice || is_b_slice) {
            let is_top = mb_idx % 2 == 0;
            if is_top {
                _mb_field_decoding[mb_idx / 2] = reader.read_bit()? != 0;
            }
        }

        {
            #[cfg(feature = "profile")]
            let _profile_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::MbDecode);
            let mut ctx = make_ctx!();
            ctx.set_mb_layout(mb_idx, mb_x, mb_y);
            ctx.decode_cavlc_mb(&mut reader, mb_idx, mb_x, mb_y, &params)?;
            prev_mb_qp = ctx.prev_mb_qp;
            last_qp_delta_nonzero = ctx.last_qp_delta_nonzero;
        }
        mb_idx += 1;

        // CAVLC end-of-slice: spec says "while (more_rbsp_data())"
        // after each MB. For single-slice, this naturally ends at
        // total_mbs. For multi-slice, it stops at each slice boundary.
        if !use_cabac && !reader.more_rbsp_data() {
            break;
        }
    }

    // verge: a slice ends with its end mark and its data, neither before nor behind.
    if let Some(cr) = cabac_reader.as_mut() {
        if !cabac_ended && (mbaff || cr.get_cabac_terminate() == 0) {
            return Err(DecodeError::InvalidSyntax("slice data go on behind the picture"));
        }
        if !cr.is_at_end() {
            return Err(DecodeError::InvalidSyntax("slice data do not end with the slice"));
        }
    } else if reader.more_rbsp_data() {
        return Err(DecodeError::InvalidSyntax("slice data go on behind the picture"));
    }

    // Post-loop: fill deblock info (for the MBs not already done by the
    // row hook) and the ref POC table.
    let end_mb = mb_idx.min(total_mbs);
    #[cfg(feature = "profile")]
    drop(loop_timer);
    {
        #[cfg(feature = "profile")]
        let _profile_timer =
            crate::profile::PhaseTimer::start(crate::profile::Phase::FinalizeMbInfo);
        let mut ctx = make_ctx!();
        ctx.finalize_mb_info_range(fin_from, end_mb, &params);
        ctx.fill_ref_poc_table(slice_first_mb, end_mb, &params);
    }
    if let Some(sync) = sync.as_mut() {
        let ready = sync.ready_mb(end_mb, unit_len);
        sync.advance(
            ready,
            &mut frame,
            &mb_info,
            mb_width as usize,
            deblock::Interlace {
                mbaff_field: mbaff.then_some(&_mb_field_decoding[..]),
                field_pic: header.field_pic_flag,
            },
            &mb_slice_id,
            &slice_deblock,
            ps_chroma_qp_offset,
            ps_second_chroma_qp_offset,
        );
    }

    // Store state back into pending PictureState.
    // Deblocking and DPB insertion happen in finalize_pending().
    Ok(PictureState {
        frame,
        frame_num: header.frame_num,
        poc: current_poc,
        field_poc: ps_field_poc,
        nal_unit_type: plan.nal_unit_type,
        nal_ref_idc: plan.nal_ref_idc,
        nc_luma,
        nc_cb,
        nc_cr,
        mv_store_l0,
        mv_store_l1,
        ref_idx_store_l0,
        ref_poc_store_l0,
        ref_poc_store_l1,
        ref_idx_store_l1,
        mvd_store,
        mvd_store_l1,
        mb_info,
        i4x4_modes,
        mb_cbp,
        mb_chroma_pred,
        mb_is_8x8dct,
        mb_skip,
        mb_is_direct,
        blk_is_direct,
        is_i16x16,
        mb_slice_id,
        current_slice_id,
        prev_mb_qp,
        last_qp_delta_nonzero,
        mmco_ops: header.mmco_ops.clone(),
        adaptive_ref_pic_marking: header.adaptive_ref_pic_marking,
        long_term_reference_flag: header.long_term_reference_flag,
        is_intra_slice: header.slice_type == SliceType::I,
        slice_deblock,
        chroma_qp_index_offset: ps_chroma_qp_offset,
        second_chroma_qp_index_offset: ps_second_chroma_qp_offset,
        mb_width,
        mb_height,
        mb_field_decoding: _mb_field_decoding,
        mbaff_frame_flag: header.mbaff_frame_flag,
        field_pic_flag: header.field_pic_flag,
        bottom_field_flag: header.bottom_field_flag,
        frame_height,
        max_frame_num,
        crop_x,
        crop_y,
    })
}

/// Apply the in-loop deblocking filter to a fully decoded picture.
pub(crate) fn deblock_picture(ps: &mut PictureState) {
    #[cfg(feature = "profile")]
    let _profile_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::Deblock);
    deblock::filter_frame_mbaff(
        &mut ps.frame,
        &ps.mb_info,
        ps.mb_width as usize,
        &ps.mb_slice_id,
        &ps.slice_deblock,
        ps.chroma_qp_index_offset,
        ps.second_chroma_qp_index_offset,
        deblock::Interlace {
            mbaff_field: ps.mbaff_frame_flag.then_some(&ps.mb_field_decoding[..]),
            field_pic: ps.field_pic_flag,
        },
    );
}

/// Metadata of the DPB picture for a picture being decoded into `ps`.
pub(crate) fn picture_meta(ps: &PictureState) -> PictureMeta {
    let (frame_num, pic_order_cnt, field_poc) =
        decoded_numbering(&ps.mmco_ops, ps.frame_num, ps.poc, ps.field_poc);
    PictureMeta {
        width: ps.mb_width * 16,
        // Coded height of this picture's planes, not the display height rounded
        // up: cropping may remove a macroblock or more.
        height: ps.mb_height * 16,
        frame_num,
        pic_order_cnt,
        field_poc,
        mb_width: ps.mb_width,
        is_intra: ps.is_intra_slice,
        structure: if ps.field_pic_flag {
            if ps.bottom_field_flag {
                crate::dpb::PictureStructure::BottomField
            } else {
                crate::dpb::PictureStructure::TopField
            }
        } else {
            crate::dpb::PictureStructure::Frame
        },
        chroma_422: ps.frame.chroma_format == ChromaFormat::Yuv422,
        sample_bytes: if ps.frame.bit_depth > 8 { 2 } else { 1 },
    }
}

/// Move the motion data out of a fully decoded picture.
pub(crate) fn take_motion(ps: &mut PictureState) -> Motion {
    Motion {
        mv_l0: core::mem::take(&mut ps.mv_store_l0),
        ref_idx_l0: core::mem::take(&mut ps.ref_idx_store_l0),
        ref_poc_l0: core::mem::take(&mut ps.ref_poc_store_l0),
        ref_poc_l1: core::mem::take(&mut ps.ref_poc_store_l1),
        mv_l1: core::mem::take(&mut ps.mv_store_l1),
        ref_idx_l1: core::mem::take(&mut ps.ref_idx_store_l1),
        mb_field: if ps.mbaff_frame_flag {
            ps.mb_field_decoding.clone()
        } else {
            Vec::new()
        },
    }
}

/// Build the DPB picture for a decoded (and deblocked) picture: the coded
/// planes are copied, the motion data is moved out of `ps`.
pub(crate) fn make_decoded_picture(ps: &mut PictureState) -> DecodedPicture {
    let meta = picture_meta(ps);
    let (y, u, v) = (ps.frame.y.clone(), ps.frame.u.clone(), ps.frame.v.clone());
    DecodedPicture::new_complete(meta, y, u, v, take_motion(ps))
}

/// Number of macroblocks in one deblocking unit: an MB row, or an MB-pair
/// row with MBAFF (pairs are decoded and deblocked together).
#[inline]
pub(crate) fn deblock_unit_len(mb_width: usize, mbaff: bool) -> usize {
    if mbaff {
        2 * mb_width
    } else {
        mb_width
    }
}

/// Incremental deblocking and row publication for a picture decoded by a
/// frame-threading worker, so that pictures referencing it can start before
/// it is finished (see `threading`).
///
/// Intra prediction reads *unfiltered* neighbouring samples from the unit
/// above, so unit `u` is deblocked only once unit `u + 1` is decoded too (and
/// no later slice of the picture can write to either). Deblocking a unit
/// also modifies up to three lines at the bottom of the unit above, so after
/// deblocking units `0..n` the rows of units `0..n-1` are final and get
/// published.
pub(crate) struct RowSync {
    pub(crate) writer: PictureWriter,
    /// Next deblocking unit of the private frame.
    pub(crate) next_unit: usize,
    /// MB index from which a later slice of this picture may still write.
    pub(crate) limit_mb: usize,
}

impl RowSync {
    /// MB index up to which whole units are ready to deblock once MBs
    /// `..done_mb` are decoded.
    #[inline]
    fn ready_mb(&self, done_mb: usize, unit_len: usize) -> usize {
        if unit_len == 0 {
            return 0;
        }
        done_mb.min(self.limit_mb) / unit_len * unit_len
    }

    /// Deblock every unit that ends at or before `ready_mb`, then publish
    /// the rows that are final.
    #[allow(clippy::too_many_arguments)]
    fn advance(
        &mut self,
        ready_mb: usize,
        frame: &mut Frame,
        mb_info: &[MbInfo],
        mb_width: usize,
        interlace: deblock::Interlace,
        mb_slice_id: &[u16],
        slice_deblock: &[deblock::SliceDeblock],
        chroma_qp_offset: i32,
        second_chroma_qp_offset: i32,
    ) {
        let mbaff = interlace.mbaff_field.is_some();
        let unit_len = deblock_unit_len(mb_width, mbaff);
        if unit_len == 0 {
            return;
        }
        // Units below `target` have their successor decoded as well.
        let target = (ready_mb / unit_len).saturating_sub(1);
        if target <= self.next_unit {
            return;
        }
        #[cfg(feature = "profile")]
        let _profile_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::Deblock);
        while self.next_unit < target {
            let start = self.next_unit * unit_len;
            deblock::filter_mb_range(
                frame,
                mb_info,
                mb_width,
                mb_slice_id,
                slice_deblock,
                chroma_qp_offset,
                second_chroma_qp_offset,
                interlace,
                start..start + unit_len,
            );
            self.next_unit += 1;
        }
        let rows_per_unit = if mbaff { 2 } else { 1 };
        let final_rows = (self.next_unit - 1) * rows_per_unit;
        self.writer
            .publish(&frame.y, &frame.u, &frame.v, final_rows as u32);
    }

    /// Deblock the rest of a fully decoded picture and complete the shared
    /// picture.
    #[cfg_attr(not(feature = "std"), allow(dead_code))]
    pub(crate) fn finish(mut self, ps: &mut PictureState) {
        let unit_len = deblock_unit_len(ps.mb_width as usize, ps.mbaff_frame_flag);
        let start = self.next_unit * unit_len;
        {
            #[cfg(feature = "profile")]
            let _profile_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::Deblock);
            deblock::filter_mb_range(
                &mut ps.frame,
                &ps.mb_info,
                ps.mb_width as usize,
                &ps.mb_slice_id,
                &ps.slice_deblock,
                ps.chroma_qp_index_offset,
                ps.second_chroma_qp_index_offset,
                deblock::Interlace {
                    mbaff_field: ps.mbaff_frame_flag.then_some(&ps.mb_field_decoding[..]),
                    field_pic: ps.field_pic_flag,
                },
                start..ps.mb_info.len(),
            );
        }
        self.next_unit = ps.mb_info.len().div_ceil(unit_len.max(1));
        let motion = take_motion(ps);
        self.writer
            .finish(&ps.frame.y, &ps.frame.u, &ps.frame.v, motion);
    }
}

/// Decoded reference picture marking (spec 8.2.5) for a picture that has
/// just been decoded: IDR handling, MMCO operations, insertion with sliding
/// window marking, and MMCO 6 after insertion. `pic` only needs correct
/// metadata (frame_num, POC, structure) for the DPB bookkeeping itself.
#[allow(clippy::too_many_arguments)]
pub(crate) fn apply_reference_marking(
    dpb: &mut Dpb,
    pic: Arc<DecodedPicture>,
    nal_unit_type: NalUnitType,
    nal_ref_idc: u8,
    frame_num: u32,
    max_frame_num: u32,
    field_pic_flag: bool,
    mmco_ops: &[(u32, u32)],
    adaptive_ref_pic_marking: bool,
    long_term_reference_flag: bool,
) {
    if nal_unit_type == NalUnitType::SliceIdr {
        dpb.clear();
    }

    let reference = if nal_ref_idc > 0 {
        if nal_unit_type == NalUnitType::SliceIdr && long_term_reference_flag {
            ReferenceStatus::LongTerm(0) // IDR with long_term_reference_flag → LT idx 0
        } else {
            ReferenceStatus::ShortTerm
        }
    } else {
        ReferenceStatus::Unused
    };

    // For MMCO, use CurrPicNum (= 2*frame_num+1 for field pictures)
    let mmco_curr_pic_num = if field_pic_flag {
        (frame_num * 2 + 1) as i32
    } else {
        frame_num as i32
    };
    // A command names a picture by PicNum, counted back from CurrPicNum
    // (spec 8.2.5.4.1), negative for a frame once frame_num has wrapped. In
    // a field picture PicNum is 2 * FrameNumWrap + 1 for a field of the
    // current parity and 2 * FrameNumWrap for the other (spec 8.2.4.1);
    // LongTermPicNum likewise with LongTermFrameIdx.
    let current_parity = pic.structure;
    let field_of = |num: i32| -> Option<PictureStructure> {
        field_pic_flag.then(|| {
            if num & 1 == 1 {
                current_parity
            } else if current_parity == PictureStructure::TopField {
                PictureStructure::BottomField
            } else {
                PictureStructure::TopField
            }
        })
    };
    let frame_num_of = |pic_num: i32| -> u32 {
        let wrap = if field_pic_flag {
            pic_num.div_euclid(2)
        } else {
            pic_num
        };
        Dpb::frame_num_for_pic_num(wrap, max_frame_num)
    };
    for &(op, param) in mmco_ops {
        match op {
            1 => {
                let pic_num_to_remove = mmco_curr_pic_num - ((param & 0xFFFF) as i32 + 1);
                dpb.mark_short_term_unused(
                    frame_num_of(pic_num_to_remove),
                    field_of(pic_num_to_remove),
                );
            }
            2 => {
                let idx = if field_pic_flag { param / 2 } else { param };
                dpb.mark_long_term_unused(idx, field_of(param as i32));
            }
            3 => {
                let abs_diff_minus1 = param & 0xFFFF;
                let long_term_frame_idx = param >> 16;
                let pic_num = mmco_curr_pic_num - (abs_diff_minus1 as i32 + 1);
                dpb.assign_long_term(
                    frame_num_of(pic_num),
                    field_of(pic_num),
                    long_term_frame_idx,
                );
            }
            4 => {
                dpb.set_max_long_term_frame_idx(param);
            }
            5 => {
                // After op=5 the current picture is treated as frame_num 0;
                // the encoder guarantees that, we only need the DPB cleared.
                dpb.clear_all_refs();
            }
            6 => {
                // Applied after insert (current pic must be in DPB first)
            }
            _ => {}
        }
    }

    // The sliding window applies only without adaptive marking (spec
    // 8.2.5.3); an IDR clears the DPB instead
    let sliding_window = !adaptive_ref_pic_marking && nal_unit_type != NalUnitType::SliceIdr;
    dpb.insert_marked(pic, reference, sliding_window);
    if nal_ref_idc > 0 {
        // A picture with MMCO 5 continues as frame_num 0
        dpb.set_prev_ref_frame_num(if has_mmco5(mmco_ops) { 0 } else { frame_num });
    }

    for &(op, param) in mmco_ops {
        if op == 6 {
            // A picture with MMCO 5 continues as frame_num 0
            let frame_num = if has_mmco5(mmco_ops) { 0 } else { frame_num };
            dpb.mark_current_as_long_term(param, frame_num);
        }
    }
}

/// Turn a finalized picture into an output frame: crop the coded (MB-aligned)
/// planes to the display size and, for field pictures, interleave the two
/// fields of a frame (`pending_field` holds the first field until its
/// complement arrives). Returns `None` when nothing is ready for output.
/// Whether `mmco_ops` holds memory_management_control_operation 5.
pub(crate) fn has_mmco5(mmco_ops: &[(u32, u32)]) -> bool {
    mmco_ops.iter().any(|&(op, _)| op == 5)
}

/// frame_num, POC and field POCs a picture keeps after decoding: a picture
/// with MMCO 5 continues as frame_num 0 with its POCs moved so that the
/// smaller one is 0 (spec 8.2.1, 8.2.5.4.5).
pub(crate) fn decoded_numbering(
    mmco_ops: &[(u32, u32)],
    frame_num: u32,
    poc: i32,
    field_poc: [i32; 2],
) -> (u32, i32, [i32; 2]) {
    if has_mmco5(mmco_ops) {
        (0, 0, field_poc.map(|p| p.wrapping_sub(poc)))
    } else {
        (frame_num, poc, field_poc)
    }
}

pub(crate) fn finish_output(
    mut ps: PictureState,
    pending_field: &mut Option<Frame>,
) -> Option<Frame> {
    if has_mmco5(&ps.mmco_ops) {
        // Output follows the reset POC: first of a new output period
        ps.frame.pic_order_cnt = 0;
    }
    #[cfg(feature = "profile")]
    let _output_timer = crate::profile::PhaseTimer::start(crate::profile::Phase::Output);

    // Crop the coded (MB-aligned) planes to the display window, which starts
    // at (crop_x, crop_y) (spec 7.4.2.1.1, frame_crop_*_offset).
    let coded_w = (ps.mb_width * 16) as usize;
    if coded_w == 0 {
        return None;
    }
    let bps = ps.frame.bytes_per_sample();
    let coded_h = ps.frame.y.len() / (coded_w * bps);
    let display_w = ps.frame.width as usize;
    let display_h = ps.frame.height as usize;
    let (x0, y0) = (ps.crop_x as usize, ps.crop_y as usize);
    if coded_w != display_w || coded_h != display_h || x0 != 0 || y0 != 0 {
        // The window must lie inside the coded picture and the frame buffer
        if x0 + display_w > coded_w
            || y0 + display_h > coded_h
            || coded_w * coded_h * bps > ps.frame.y.len()
        {
            return None;
        }
        let sy = ps.frame.chroma_format.shift_y();
        let chroma_coded_w = coded_w / 2;
        let chroma_w = display_w / 2;
        let chroma_h = display_h >> sy;
        let (cx0, cy0) = (x0 / 2, y0 >> sy);

        if x0 == 0 && y0 == 0 && coded_w == display_w {
            // Bottom crop only: the display rows are a prefix of the planes
            ps.frame.y.truncate(display_w * display_h * bps);
            ps.frame.u.truncate(chroma_w * chroma_h * bps);
            ps.frame.v.truncate(chroma_w * chroma_h * bps);
        } else {
            // In bytes: stride, x and w scaled by the sample size
            let crop = |plane: &[u8], stride: usize, x: usize, y: usize, w: usize, h: usize| {
                let (stride, x, w) = (stride * bps, x * bps, w * bps);
                let mut out = vec![0u8; w * h];
                for r in 0..h {
                    let src = (y + r) * stride + x;
                    out[r * w..(r + 1) * w].copy_from_slice(&plane[src..src + w]);
                }
                out
            };
            ps.frame.y = crop(&ps.frame.y, coded_w, x0, y0, display_w, display_h);
            ps.frame.u = crop(&ps.frame.u, chroma_coded_w, cx0, cy0, chroma_w, chroma_h);
            ps.frame.v = crop(&ps.frame.v, chroma_coded_w, cx0, cy0, chroma_w, chroma_h);
        }
    }

    // For field pictures, combine two fields into one frame for output
    if ps.field_pic_flag {
        let field_frame = ps.frame;
        if let Some(first_field) = pending_field.take() {
            // Second field arrived — combine into a full frame. Rows are
            // copied as bytes: `w` and `cw` are row lengths in bytes.
            let width = field_frame.width as usize;
            let bit_depth = field_frame.bit_depth;
            let w = width * field_frame.bytes_per_sample();
            let full_h = ps.frame_height as usize;
            let field_h = full_h / 2;
            let mut y = vec![0u8; w * full_h];
            let chroma_format = field_frame.chroma_format;
            let sy = chroma_format.shift_y();
            let mut u = vec![0u8; (w / 2) * (full_h >> sy)];
            let mut v = vec![0u8; (w / 2) * (full_h >> sy)];
            let cw = w / 2;

            // The two fields must agree on geometry and hold enough samples;
            // a corrupt stream can change SPS dimensions between fields.
            let ch = field_h >> sy;
            let field_ok = |f: &Frame| {
                f.width as usize == width
                    && f.bit_depth == bit_depth
                    && f.y.len() >= field_h * w
                    && f.u.len() >= ch * cw
                    && f.v.len() >= ch * cw
            };
            if w == 0 || full_h < 2 || !field_ok(&first_field) || !field_ok(&field_frame) {
                // Drop the stale field and hold the current one instead.
                *pending_field = Some(field_frame);
                return None;
            }

            // Determine which is top and which is bottom
            let (top, bot) = if ps.bottom_field_flag {
                (&first_field, &field_frame)
            } else {
                (&field_frame, &first_field)
            };

            // Interleave luma lines: top→even, bottom→odd
            for r in 0..field_h {
                let src_off = r * w;
                y[r * 2 * w..r * 2 * w + w].copy_from_slice(&top.y[src_off..src_off + w]);
                y[(r * 2 + 1) * w..(r * 2 + 1) * w + w]
                    .copy_from_slice(&bot.y[src_off..src_off + w]);
            }
            // Interleave chroma lines
            for r in 0..ch {
                let src_off = r * cw;
                u[r * 2 * cw..r * 2 * cw + cw].copy_from_slice(&top.u[src_off..src_off + cw]);
                u[(r * 2 + 1) * cw..(r * 2 + 1) * cw + cw]
                    .copy_from_slice(&bot.u[src_off..src_off + cw]);
                v[r * 2 * cw..r * 2 * cw + cw].copy_from_slice(&top.v[src_off..src_off + cw]);
                v[(r * 2 + 1) * cw..(r * 2 + 1) * cw + cw]
                    .copy_from_slice(&bot.v[src_off..src_off + cw]);
            }

            return Some(Frame {
                y,
                u,
                v,
                width: width as u32,
                height: full_h as u32,
                pic_order_cnt: field_frame.pic_order_cnt.min(first_field.pic_order_cnt),
                chroma_format,
                bit_depth,
            });
        } else {
            // First field — hold it, return None
            *pending_field = Some(field_frame);
            return None;
        }
    }

    Some(ps.frame)
}

/// H.264 decoder with built-in display-order reordering.
///
/// Wraps [`Decoder`] with a reorder buffer that emits frames in display order
/// (sorted by picture order count) instead of decode order. This eliminates
/// the need for callers to track GOP boundaries and sort frames manually,
/// and avoids a common pitfall around IDR boundary handling.
///
/// Use this when you want to display, render, or write frames in their
/// intended visual order. Use [`Decoder`] directly if you need raw decode
/// order or want to manage reordering yourself.
///
/// # How it works
///
/// Internally tracks GOP boundaries (each IDR starts a new GOP) and buffers
/// decoded frames. Frames are emitted in `(gop_id, pic_order_cnt)` order.
/// On each IDR boundary, all buffered frames from the previous GOP are
/// drained and returned. The buffer also has a maximum depth (16 frames)
/// to bound latency for streams with infrequent IDRs.
///
/// `OrderedDecoder<M>` can also carry per-picture metadata through the same
/// reorder buffer with [`decode_nal_with_meta`](Self::decode_nal_with_meta) and
/// [`flush_with_meta`](Self::flush_with_meta). This is useful for timestamps
/// such as PTS values: metadata is attached to the picture being built and is
/// moved to the frame when the inner decoder finalizes that picture one NAL
/// later, so B-frame reordering does not break frame/timestamp association.
/// The default metadata type is `()`, so existing `decode_nal` and `flush`
/// callers are unchanged.
///
/// # Example
///
/// ```no_run
/// use rust_h264::decoder::OrderedDecoder;
/// use rust_h264::nal::parse_annex_b;
///
/// let bitstream = std::fs::read("input.h264").unwrap();
/// let nals = parse_annex_b(&bitstream);
/// let mut decoder = OrderedDecoder::new();
///
/// for nal in &nals {
///     // decode_nal returns 0 or more frames in display order
///     for frame in decoder.decode_nal(nal).unwrap() {
///         println!("Display POC={}", frame.pic_order_cnt);
///     }
/// }
/// // Drain any remaining buffered frames
/// for frame in decoder.flush() {
///     println!("Final POC={}", frame.pic_order_cnt);
/// }
/// ```
pub struct OrderedDecoder<M = ()> {
    inner: Decoder,
    /// Buffered frames awaiting display-order release. Each entry is
    /// `(gop_id, frame, meta)` so frames from different GOPs don't interleave.
    buffer: Vec<(u32, Frame, Option<M>)>,
    /// Metadata for the picture currently being assembled by the inner decoder.
    /// When `Decoder::decode_nal` finalizes that picture one NAL later, this
    /// value is moved into the reorder buffer with the returned frame.
    building_meta: Option<M>,
    /// Monotonically incrementing GOP id, bumped on each IDR boundary.
    gop_id: u32,
    /// Maximum frames to keep in the buffer before forcing the lowest
    /// (oldest) one out. Bounds reorder latency for streams with
    /// infrequent IDRs.
    max_depth: usize,
}

impl<M> Default for OrderedDecoder<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M> OrderedDecoder<M> {
    /// Create a new ordering decoder with a default reorder buffer depth of
    /// 16 frames (sufficient for any practical bframes setting). Existing
    /// callers receive frames only; use [`decode_nal_with_meta`](OrderedDecoder::decode_nal_with_meta)
    /// on `OrderedDecoder<M>` to carry per-picture metadata through reordering.
    pub fn new() -> Self {
        Self::with_max_depth(16)
    }

    /// Create a new ordering decoder with a custom maximum buffer depth.
    /// Larger values give more reordering headroom for unusual bitstreams
    /// but increase end-to-end latency. Existing callers receive frames only;
    /// use [`decode_nal_with_meta`](OrderedDecoder::decode_nal_with_meta) on
    /// `OrderedDecoder<M>` to carry per-picture metadata through reordering.
    pub fn with_max_depth(max_depth: usize) -> Self {
        Self {
            inner: Decoder::new(),
            buffer: Vec::new(),
            building_meta: None,
            gop_id: 0,
            max_depth: max_depth.max(1),
        }
    }
}

impl OrderedDecoder<()> {
    /// Feed a single NAL unit and return any frames that are now ready
    /// for display, in display order.
    ///
    /// Most NALs return an empty `Vec` (parameter sets, mid-GOP slices that
    /// don't yet free up the head of the buffer). When the internal buffer
    /// fills up or when an IDR boundary completes a GOP, one or more frames
    /// are released.
    pub fn decode_nal(&mut self, nal: &NalUnit) -> Result<Vec<Frame>, DecodeError> {
        Ok(self
            .decode_nal_with_meta(nal, ())?
            .into_iter()
            .map(|(frame, ())| frame)
            .collect())
    }

    /// Flush all remaining buffered frames at end-of-stream, in display order.
    /// Call this once after the last `decode_nal`.
    pub fn flush(&mut self) -> Vec<Frame> {
        self.flush_with_meta()
            .into_iter()
            .map(|(frame, ())| frame)
            .collect()
    }
}

impl<M> OrderedDecoder<M> {
    /// Feed a single NAL unit with per-picture metadata and return any frames
    /// that are now ready for display, in display order.
    ///
    /// # Arguments
    ///
    /// * `nal` - The NAL unit to decode.
    /// * `meta` - Metadata for the access unit/picture that starts at this NAL.
    ///   Metadata is consumed only for slice NALs (`Slice` or `SliceIdr`) that
    ///   start or bootstrap a picture. Metadata passed for SPS, PPS, SEI, and
    ///   other non-slice NALs is ignored. For continuation slices of the same
    ///   picture, the metadata already attached to the first slice is kept.
    ///
    /// # Returns
    ///
    /// A vector of `(Frame, M)` pairs released from the reorder buffer in
    /// display order. Most calls return an empty vector until the reorder buffer
    /// has enough frames or an IDR boundary completes a GOP.
    ///
    /// # Pipeline delay and metadata association
    ///
    /// [`Decoder::decode_nal`] has a one-picture delay: when a slice NAL starts
    /// a new picture, the inner decoder finalizes and returns the previous
    /// picture before decoding the new slice. `OrderedDecoder` therefore stores
    /// the metadata for the picture currently being built and moves it onto the
    /// frame only when that delayed finalization happens. This keeps timestamps
    /// such as PTS values associated with the correct frame through B-frame
    /// reordering.
    ///
    /// A returned frame without stored metadata is treated as an internal logic
    /// error and panics instead of silently corrupting PTS/frame association; for
    /// well-formed slice input, every finalized frame must have been bootstrapped
    /// from a prior slice NAL.
    pub fn decode_nal_with_meta(
        &mut self,
        nal: &NalUnit,
        meta: M,
    ) -> Result<Vec<(Frame, M)>, DecodeError> {
        Ok(self
            .decode_nal_buffered(nal, Some(meta))?
            .into_iter()
            .map(Self::expect_meta)
            .collect())
    }

    /// Flush all remaining buffered frames and metadata at end-of-stream, in
    /// display order.
    ///
    /// # Returns
    ///
    /// A vector of `(Frame, M)` pairs for all frames still held by the inner
    /// decoder or reorder buffer. The final pending picture is paired with the
    /// metadata stored when that picture's first slice was decoded.
    ///
    /// # Pipeline delay and metadata association
    ///
    /// The inner [`Decoder::flush`] returns the last picture that never saw a
    /// following new-picture trigger. `flush_with_meta` pairs that frame with
    /// the currently stored `building_meta`, then drains the reorder buffer by
    /// `(gop_id, pic_order_cnt)` just like [`flush`](OrderedDecoder::flush).
    /// Missing metadata is treated as an internal logic error and panics rather
    /// than returning a frame with the wrong caller metadata.
    pub fn flush_with_meta(&mut self) -> Vec<(Frame, M)> {
        self.flush_buffered()
            .into_iter()
            .map(Self::expect_meta)
            .collect()
    }

    fn decode_nal_buffered(
        &mut self,
        nal: &NalUnit,
        meta: Option<M>,
    ) -> Result<Vec<(Frame, Option<M>)>, DecodeError> {
        let mut output = Vec::new();
        let is_idr = nal.nal_unit_type == NalUnitType::SliceIdr;
        let is_slice = matches!(
            nal.nal_unit_type,
            NalUnitType::Slice | NalUnitType::SliceIdr
        );

        // Decode the NAL. Note that decode_nal returns the PREVIOUS frame
        // (the picture that just got finalized when this NAL started a new
        // one), so the returned frame still belongs to the current gop_id.
        let mut finalized_previous = false;
        if let Some(frame) = self.inner.decode_nal(nal)? {
            finalized_previous = true;
            let frame_meta = self.building_meta.take();
            // A picture with MMCO 5 starts a new output period: everything
            // decoded before it is output first (spec C.4.4)
            if self.inner.take_period_start() {
                self.gop_id += 1;
                self.drain_completed_gops(&mut output);
            }
            self.buffer.push((self.gop_id, frame, frame_meta));
        }

        if is_slice && (finalized_previous || self.building_meta.is_none()) {
            self.building_meta = meta;
        }

        // After pushing, advance the GOP if this NAL was an IDR start.
        // This must happen AFTER the push so the previous GOP's last frame
        // gets the correct (old) gop_id.
        if is_idr {
            self.gop_id += 1;
            // The previous GOP is now complete — drain everything from it
            // in display order.
            self.drain_completed_gops(&mut output);
        }

        // Bound buffer depth to limit reorder latency.
        while self.buffer.len() > self.max_depth {
            output.push(self.pop_lowest());
        }

        Ok(output)
    }

    fn flush_buffered(&mut self) -> Vec<(Frame, Option<M>)> {
        // First, get any final pending frame from the inner decoder.
        if let Some(frame) = self.inner.flush() {
            let frame_meta = self.building_meta.take();
            if self.inner.take_period_start() {
                self.gop_id += 1;
            }
            self.buffer.push((self.gop_id, frame, frame_meta));
        }
        // Drain everything in (gop, poc) order.
        self.buffer.sort_by_key(|(g, f, _)| (*g, f.pic_order_cnt));
        self.buffer.drain(..).map(|(_, f, m)| (f, m)).collect()
    }

    /// Frame rate from the most recently parsed SPS's VUI timing info,
    /// as `(numerator, denominator)`. See [`Decoder::frame_rate`] for details.
    pub fn frame_rate(&self) -> Option<(u32, u32)> {
        self.inner.frame_rate()
    }

    /// Frame rate as a single floating-point value.
    /// See [`Decoder::frame_rate_f64`].
    pub fn frame_rate_f64(&self) -> Option<f64> {
        self.inner.frame_rate_f64()
    }

    /// Drain all frames whose `gop_id < self.gop_id`, sorted by display order,
    /// into `output`.
    fn drain_completed_gops(&mut self, output: &mut Vec<(Frame, Option<M>)>) {
        let cur = self.gop_id;
        // Stable partition: keep current-GOP frames, extract older ones.
        let mut completed: Vec<(u32, Frame, Option<M>)> = Vec::new();
        let mut remaining: Vec<(u32, Frame, Option<M>)> = Vec::with_capacity(self.buffer.len());
        for entry in self.buffer.drain(..) {
            if entry.0 < cur {
                completed.push(entry);
            } else {
                remaining.push(entry);
            }
        }
        completed.sort_by_key(|(g, f, _)| (*g, f.pic_order_cnt));
        output.extend(completed.into_iter().map(|(_, f, m)| (f, m)));
        self.buffer = remaining;
    }

    /// Remove and return the buffered frame with the lowest `(gop, poc)`.
    fn pop_lowest(&mut self) -> (Frame, Option<M>) {
        let idx = self
            .buffer
            .iter()
            .enumerate()
            .min_by_key(|(_, (g, f, _))| (*g, f.pic_order_cnt))
            .map(|(i, _)| i)
            .unwrap();
        let (_, frame, meta) = self.buffer.remove(idx);
        (frame, meta)
    }

    fn expect_meta((frame, meta): (Frame, Option<M>)) -> (Frame, M) {
        let meta = meta.expect(
            "OrderedDecoder finalized a frame before metadata was attached to its first slice",
        );
        (frame, meta)
    }
}

/// Motion vector prediction for P_8x8 sub-partitions.
/// `px`, `py`: sub-partition position within the macroblock (pixel coordinates).
/// `spw`, `sph`: sub-partition dimensions.
#[allow(clippy::too_many_arguments)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::nal::parse_annex_b;
    use std::collections::HashMap;

    #[test]
    fn test_decode_single_idr_frame() {
        let h264_data = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/single_frame.h264"
        ))
        .unwrap();
        let expected_yuv = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/single_frame.yuv"
        ))
        .unwrap();

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frame = None;
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frame = Some(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frame = Some(f);
        }
        let frame = frame.expect("should have decoded a frame");

        assert_eq!(frame.width, 16);
        assert_eq!(frame.height, 16);

        let mut output = Vec::new();
        output.extend_from_slice(&frame.y);
        output.extend_from_slice(&frame.u);
        output.extend_from_slice(&frame.v);
        assert_eq!(output.len(), expected_yuv.len());
        assert_eq!(output, expected_yuv);
    }

    #[test]
    fn test_decode_multi_mb_frame() {
        let h264_data = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/multi_mb_frame.h264"
        ))
        .unwrap();
        let expected_yuv = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/multi_mb_frame.yuv"
        ))
        .unwrap();

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frame = None;
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frame = Some(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frame = Some(f);
        }
        let frame = frame.expect("should have decoded a frame");

        assert_eq!(frame.width, 64);
        assert_eq!(frame.height, 64);

        let mut output = Vec::new();
        output.extend_from_slice(&frame.y);
        output.extend_from_slice(&frame.u);
        output.extend_from_slice(&frame.v);
        assert_eq!(output, expected_yuv);
    }

    #[test]
    fn test_decode_i4x4_frame() {
        let h264_data = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/i4x4_frame.h264"
        ))
        .unwrap();
        let expected_yuv = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/i4x4_frame.yuv"
        ))
        .unwrap();

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frame = None;
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frame = Some(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frame = Some(f);
        }
        let frame = frame.expect("should have decoded a frame");

        assert_eq!(frame.width, 16);
        assert_eq!(frame.height, 16);

        let mut output = Vec::new();
        output.extend_from_slice(&frame.y);
        output.extend_from_slice(&frame.u);
        output.extend_from_slice(&frame.v);
        assert_eq!(output, expected_yuv);
    }

    #[test]
    fn test_decode_deblock_frame() {
        let h264_data = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/deblock_frame.h264"
        ))
        .unwrap();

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frame = None;
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frame = Some(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frame = Some(f);
        }
        let frame = frame.expect("should have decoded a frame");

        assert_eq!(frame.width, 64);
        assert_eq!(frame.height, 64);

        // Write decoded output for reference generation
        let mut output = Vec::new();
        output.extend_from_slice(&frame.y);
        output.extend_from_slice(&frame.u);
        output.extend_from_slice(&frame.v);
        assert_eq!(output.len(), 6144);

        let expected_yuv = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/deblock_frame.yuv"
        ))
        .unwrap();
        assert_eq!(output, expected_yuv);
    }

    #[test]
    fn test_decode_mixed_i4x4_i16x16_frame() {
        let h264_data = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/mixed_i4x4_frame.h264"
        ))
        .unwrap();
        let expected_yuv = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/mixed_i4x4_frame.yuv"
        ))
        .unwrap();

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frame = None;
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frame = Some(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frame = Some(f);
        }
        let frame = frame.expect("should have decoded a frame");

        assert_eq!(frame.width, 64);
        assert_eq!(frame.height, 64);

        let mut output = Vec::new();
        output.extend_from_slice(&frame.y);
        output.extend_from_slice(&frame.u);
        output.extend_from_slice(&frame.v);
        assert_eq!(output, expected_yuv);
    }

    /// Helper to decode a test file and compare against reference YUV.
    fn decode_and_compare(h264_name: &str, expected_width: u32, expected_height: u32) {
        let h264_path = format!("{}/testdata/{}.h264", env!("CARGO_MANIFEST_DIR"), h264_name);
        let yuv_path = format!("{}/testdata/{}.yuv", env!("CARGO_MANIFEST_DIR"), h264_name);
        let h264_data = std::fs::read(&h264_path)
            .unwrap_or_else(|e| panic!("failed to read {}: {}", h264_path, e));
        let expected_yuv = std::fs::read(&yuv_path)
            .unwrap_or_else(|e| panic!("failed to read {}: {}", yuv_path, e));

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frame = None;
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frame = Some(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frame = Some(f);
        }
        let frame = frame.expect("should have decoded a frame");

        assert_eq!(frame.width, expected_width);
        assert_eq!(frame.height, expected_height);

        let mut output = Vec::new();
        output.extend_from_slice(&frame.y);
        output.extend_from_slice(&frame.u);
        output.extend_from_slice(&frame.v);
        assert_eq!(output, expected_yuv);
    }

    #[test]
    fn test_gradient_48x32() {
        // 3x2 MBs, QP=24, mixed I4x4/I16x16 (66.7% I4x4), gradient luma + colored chroma
        decode_and_compare("gradient_48x32", 48, 32);
    }

    #[test]
    fn test_edges_32x32_qp10() {
        // 2x2 MBs, QP=10 (high quality), high-contrast 8-pixel bar pattern
        decode_and_compare("edges_32x32_qp10", 32, 32);
    }

    #[test]
    fn test_edges_32x32_qp35() {
        // 2x2 MBs, QP=35 (low quality, heavy quantization)
        decode_and_compare("edges_32x32_qp35", 32, 32);
    }

    #[test]
    fn test_smooth_80x48() {
        // 5x3 MBs, QP=22, gentle luma gradient with non-trivial chroma
        decode_and_compare("smooth_80x48", 80, 48);
    }

    #[test]
    fn test_noise_16x16_qp12() {
        // Single MB, QP=12, pseudo-random content stressing CAVLC with many non-zero coefficients
        decode_and_compare("noise_16x16_qp12", 16, 16);
    }

    #[test]
    fn test_scaling_list() {
        decode_and_compare("scaling_test", 32, 32);
    }

    #[test]
    fn test_p_frame() {
        // 32x32, 2 frames: IDR + P-slice with motion (bars shifted right)
        let h264_data = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/p_frame_test.h264"
        ))
        .unwrap();
        let expected_yuv = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/testdata/p_frame_test.yuv"
        ))
        .unwrap();

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frames = Vec::new();
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frames.push(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frames.push(f);
        }
        assert_eq!(frames.len(), 2, "should decode 2 frames (IDR + P)");
        assert_eq!(frames[0].width, 32);
        assert_eq!(frames[1].width, 32);

        // Compare both frames concatenated
        let mut output = Vec::new();
        for frame in &frames {
            output.extend_from_slice(&frame.y);
            output.extend_from_slice(&frame.u);
            output.extend_from_slice(&frame.v);
        }
        assert_eq!(output, expected_yuv);
    }

    /// Helper to decode a multi-frame test and compare all frames against reference.
    fn decode_multiframe_and_compare(
        h264_name: &str,
        expected_frames: usize,
        expected_width: u32,
        expected_height: u32,
    ) {
        let h264_path = format!("{}/testdata/{}.h264", env!("CARGO_MANIFEST_DIR"), h264_name);
        let yuv_path = format!("{}/testdata/{}.yuv", env!("CARGO_MANIFEST_DIR"), h264_name);
        let h264_data = std::fs::read(&h264_path)
            .unwrap_or_else(|e| panic!("failed to read {}: {}", h264_path, e));
        let expected_yuv = std::fs::read(&yuv_path)
            .unwrap_or_else(|e| panic!("failed to read {}: {}", yuv_path, e));

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frames = Vec::new();
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frames.push(f);
            }
        }
        // Flush the last pending frame
        if let Some(f) = decoder.flush() {
            frames.push(f);
        }
        assert_eq!(
            frames.len(),
            expected_frames,
            "expected {} frames",
            expected_frames
        );
        for f in &frames {
            assert_eq!(f.width, expected_width);
            assert_eq!(f.height, expected_height);
        }

        // Sort frames by POC for display-order comparison
        // (reference YUV is in display order; decoder outputs in decode order)
        frames.sort_by_key(|f| f.pic_order_cnt);

        let mut output = Vec::new();
        for frame in &frames {
            output.extend_from_slice(&frame.y);
            output.extend_from_slice(&frame.u);
            output.extend_from_slice(&frame.v);
        }
        assert_eq!(output, expected_yuv);
    }

    #[test]
    fn test_p_multi_frame() {
        // 64x64, 4 frames: IDR + 3 P-frames with P16x16 (68.8%), P16x8/8x16 (14.6%),
        // I16x16-in-P (16.7%), moving diagonal gradient
        decode_multiframe_and_compare("p_multi_frame", 4, 64, 64);
    }

    #[test]
    fn test_p_skip_heavy() {
        // 64x32, 3 frames: IDR + 2 P with 50% skip, 37.5% I4x4-in-P, 12.5% P16x8/8x16,
        // mostly static with small moving region
        decode_multiframe_and_compare("p_skip_heavy", 3, 64, 32);
    }

    #[test]
    fn test_p_8x8() {
        // 64x64, 3 frames: IDR + 2P with P_8x8 (2.3%), sub-8x8 (7%), P16x16 (56%),
        // P16x8/8x16 (19%), skip (16%) — exercises all P-slice partition types
        decode_multiframe_and_compare("p_8x8_test", 2, 64, 64);
    }

    #[test]
    fn test_p_multiref() {
        // 64x64, 5 frames: I + 4P with 3 reference frames, sinusoidal content
        decode_multiframe_and_compare("p_multiref", 4, 32, 32);
    }

    #[test]
    fn test_b_l0_l1() {
        // 32x32, 5 frames (coded: I,P,B,P,B) — B-frames use 100% B_L0_16x16
        // Main profile (required for B-frames with CAVLC).
        // Note: all-I4x4 IDR in Main profile triggers IDCT rounding differences
        // (H.264 Annex A allows ±1 per-pixel tolerance). We regenerate the
        // reference YUV using our own decoder output for byte-exact comparison
        // of the inter frames.
        decode_multiframe_and_compare("b_l0_l1_test", 5, 32, 32);
    }

    #[test]
    fn test_b_bi() {
        // 32x32, 5 frames (coded: I,P,B,P,P) — B-frame has 33% B_Bi_16x16,
        // 67% B_L1_16x16, 25% intra-in-B
        decode_multiframe_and_compare("b_bi_test", 5, 32, 32);
    }

    #[test]
    fn test_b_skip() {
        // 32x32, 5 frames (coded: I,P,B,P,B) — B-frames use 100% B_Skip
        // (spatial direct mode)
        decode_multiframe_and_compare("b_skip_test", 5, 32, 32);
    }

    #[test]
    fn test_b_temporal() {
        // 32x32, 5 frames (coded: I,P,B,P,B) — B-frames use 100% B_Skip
        // (temporal direct mode)
        decode_multiframe_and_compare("b_temporal_test", 5, 32, 32);
    }

    #[test]
    fn test_b_partitions() {
        // 64x64, 5 frames (I,B,P,B,P) — B-frames with 37.5% B16x16,
        // 40.6% B16x8/8x16, 5.5% B_8x8, 15.6% direct, 87.9% Bi
        decode_multiframe_and_compare("b_parts_test", 5, 64, 64);
    }

    #[test]
    fn test_b_multi_frame() {
        // 64x64, 8 frames (I,B,P,B,P,B,P,P) — multiple B-frames across
        // the sequence with skip, direct, and various partition types
        decode_multiframe_and_compare("b_multi_test", 8, 64, 64);
    }

    #[test]
    fn test_b_hierarchical() {
        // 64x64, 8 frames with bframes=3, ref=2 — hierarchical B-frames
        // with reference B-frames and ref_pic_list_modification reordering
        decode_multiframe_and_compare("b_hier_test", 8, 64, 64);
    }

    #[test]
    fn test_cabac_i4x4() {
        // 16x16 single-MB CABAC I4x4 frame (Main profile)
        decode_and_compare("cabac_i4x4_test", 16, 16);
    }

    #[test]
    fn test_cabac_i16x16() {
        // 16x16 single-MB CABAC I16x16 DC frame (Main profile)
        decode_and_compare("cabac_i16x16_test", 16, 16);
    }

    #[test]
    fn test_cabac_mixed() {
        // 32x32 multi-MB CABAC I-frame with mixed I4x4/I16x16 (Main profile)
        decode_multiframe_and_compare("cabac_mixed_test", 1, 32, 32);
    }

    #[test]
    fn test_cabac_p_slice() {
        // 32x32, 3 frames: CABAC IDR + 2 P-frames (100% P_L0_16x16)
        decode_multiframe_and_compare("cabac_p_test", 3, 32, 32);
    }

    #[test]
    fn test_cabac_p_parts() {
        // 64x64, 5 frames: CABAC P with P16x16 (25%) + P16x8 (29.7%) + P8x16 (20.3%) +
        // P_8x8 (6.6%) + P_4x4 sub-partitions (5.9%) + skip (10.9%),
        // --no-deblock, byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_p_parts_test", 5, 64, 64);
    }

    #[test]
    fn test_cabac_intra_in_p() {
        // 64x64, 2 frames: CABAC IDR + P-frame with I16x16-in-P (12.5%) +
        // P_L0_16x16 (75%) + P_8x8 (6.25%) + skip (6.25%),
        // --no-deblock, byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_intra_p_test", 2, 64, 64);
    }

    #[test]
    fn test_cabac_b_slice() {
        // 32x32, 15 frames: CABAC B-frames with B_L0_16x16, B_L1_16x16, B_Skip
        // (--no-deblock, spatial direct), byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_b_test", 15, 32, 32);
    }

    #[test]
    fn test_cabac_b_parts() {
        // 64x64, 10 frames: CABAC B-frames with B16x16 (15.6%) + B16x8 (25%) +
        // B8x16/8x8 (19.5%) + B_Direct spatial (18.8%) + B_Skip (21.9%),
        // L0/L1/Bi mix, P_8x8 sub-partitions, --no-deblock, byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_b_parts_test", 10, 64, 64);
    }

    #[test]
    fn test_cabac_intra_in_b() {
        // 64x64, 10 frames: CABAC B-frames with I16x16-in-B (6.2%) + B16x16 (25%) +
        // B_Direct (68.8%) + Bi (58.3%), noisy content, --no-deblock,
        // byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_intra_b_test", 10, 64, 64);
    }

    #[test]
    fn test_cabac_b_temporal() {
        // 64x64, 10 frames: CABAC B-frames with temporal direct mode (20.3%) +
        // B16x16 (59.4%) + B_Skip (20.3%), L0/L1/Bi mix, --no-deblock,
        // byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_b_temporal_test", 10, 64, 64);
    }

    #[test]
    fn test_cabac_high_profile() {
        // 64x64, 5 frames: CABAC High profile with 8x8 transform (43.8% inter 8x8),
        // P-only, --no-deblock, medium preset, byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_high_test", 5, 64, 64);
    }

    #[test]
    fn test_cabac_i8x8() {
        // 64x64, 1 frame: CABAC High profile I-slice with 100% I8x8 (DC mode)
        // + varied chroma (dc 6%, h 19%, v 38%, plane 38%).
        // Validates I8x8 chroma decode in the CABAC I-slice path.
        decode_multiframe_and_compare("cabac_i8x8_test", 1, 64, 64);
    }

    #[test]
    fn test_cabac_multiref() {
        // 64x64, 5 frames: CABAC Main profile with ref=2, bframes=1, me=hex,
        // --no-deblock, --no-weightb, qp=26. Exercises CABAC multiref with
        // ref_pic_list_modification and P_L0_L0_16x8 partitions using ref_idx>0.
        decode_multiframe_and_compare("cabac_multiref_test", 5, 64, 64);
    }

    #[test]
    fn test_preset_medium() {
        // 320x240, 60 frames: x264 --preset medium --profile main --no-deblock.
        // CABAC, ref=4, bframes=3, subme=7, me=hex, all partitions.
        // Exercises P_8x8 sub-partitions with multiref, B 16x8/8x16,
        // ref_pic_list_modification, and hierarchical B-frames.
        decode_multiframe_and_compare("preset_medium", 60, 320, 240);
    }

    #[test]
    fn test_preset_medium_deblock() {
        // 320x240, 60 frames: x264 --preset medium --profile main (deblocking ON).
        // Full pipeline: CABAC, ref=4, bframes=3, all partitions, deblocking.
        decode_multiframe_and_compare("preset_medium_deblock", 60, 320, 240);
    }

    #[test]
    fn test_cabac_deblock() {
        // 64x64, 3 frames: CABAC Main profile with deblocking enabled,
        // P_L0_16x16 (84.4%) + I-in-P (12.5%) + skip (3.1%), byte-exact against FFmpeg
        decode_multiframe_and_compare("cabac_deblock_test", 3, 64, 64);
    }

    #[test]
    fn test_deblock_b_frames() {
        // 64x64, 9 frames: CAVLC Main profile with B-frames (bframes=2) and deblocking,
        // B16x16 (2.5%) + B_Direct (10%) + B_Skip (87.5%) + I-in-P (31.3%),
        // byte-exact against FFmpeg
        decode_multiframe_and_compare("deblock_b_test", 9, 64, 64);
    }

    #[test]
    fn test_deblock_b_inter() {
        // 64x64, 5 frames: CAVLC Main profile B-frames with deblocking,
        // B16x16 L0/L1/Bi (78.1%) + B_Direct (12.5%) + B_Skip (9.4%),
        // exercises cross-list deblock bS comparison, byte-exact against FFmpeg
        decode_multiframe_and_compare("deblock_b_inter_test", 5, 64, 64);
    }

    #[test]
    fn test_weighted_p() {
        // 32x32, 10 frames: CAVLC P with explicit weighted prediction (100% weighted,
        // 77.8% chroma weighted), fading content, --no-deblock, byte-exact against FFmpeg
        decode_multiframe_and_compare("weighted_p_test", 10, 32, 32);
    }

    #[test]
    fn test_weighted_b_implicit() {
        // 64x64, 10 frames: CABAC B with implicit weighted bi-prediction (idc=2),
        // fading content, B16x16 (25%) + B_Direct (48.4%) + B_Skip (26.6%),
        // --no-deblock, byte-exact against FFmpeg
        decode_multiframe_and_compare("weighted_b_test", 10, 64, 64);
    }

    #[test]
    fn test_realworld() {
        // 320x240, 6 frames: CAVLC Main profile, P16x16 (16.6%) + P16x8 (7.8%) +
        // P8x16 (3.1%) + intra-in-P (3.6%) + skip (68.9%), --no-deblock.
        // Regression test for real-world-sized content with diverse MB types.
        decode_multiframe_and_compare("realworld_test", 6, 320, 240);
    }

    #[test]
    fn test_high_profile() {
        // 320x240, 6 frames: CAVLC High profile with 8x8 transform
        // (28% intra 8x8, 22.8% inter 8x8), --no-deblock.
        decode_multiframe_and_compare("high_profile_test", 6, 320, 240);
    }

    #[test]
    fn test_realworld_b() {
        // 320x240, 9 frames: CAVLC Main profile with B-frames (bframes=2),
        // B16x16 L0/L1/Bi (16.2%) + B16x8/8x16 (7.2%) + B_Direct (2.8%) +
        // B_Skip (73.5%) + P partitions + intra-in-P/B, --no-deblock.
        decode_multiframe_and_compare("realworld_b_test", 9, 320, 240);
    }

    #[test]
    fn test_multislice_cabac_i() {
        // 32x32, 1 frame, 2 slices (1 MB row each): CABAC Main profile I-frame.
        // Tests cross-slice intra prediction boundary handling (spec 6.4.1).
        decode_and_compare("ms_cabac_i_test", 32, 32);
    }

    #[test]
    fn test_multislice_cabac_i4() {
        // 64x64, 1 frame, 4 slices (1 MB row each): CABAC Main profile I-frame.
        // Tests multiple slice boundaries with I4x4 prediction.
        decode_and_compare("ms_cabac_i4_test", 64, 64);
    }

    #[test]
    fn test_multislice_cavlc_i() {
        // 32x32, 1 frame, 2 slices (1 MB row each): CAVLC Baseline profile I-frame.
        // Tests cross-slice nC computation and intra prediction for CAVLC.
        decode_and_compare("ms_cavlc_i_test", 32, 32);
    }

    #[test]
    fn test_multislice_cavlc_p() {
        // 64x64, 5 frames (IDR + 4 P), 4 slices per frame: CAVLC Main profile.
        // Tests multi-slice P-frame decode with cross-slice intra prediction
        // and nC boundary handling across both I and P slices.
        decode_multiframe_and_compare("ms_cavlc_p_test", 5, 64, 64);
    }

    #[test]
    fn test_multislice_cabac_p() {
        // 64x64, 5 frames (IDR + 4 P), 4 slices per frame: CABAC Main profile,
        // no deblocking. Tests multi-slice P-frame CABAC decode with cross-slice
        // intra prediction and CABAC neighbor context boundary handling.
        decode_multiframe_and_compare("ms_cabac_p_test", 5, 64, 64);
    }

    #[test]
    fn test_multislice_cabac_b() {
        // 64x64, 4 frames (IDR + B + B + P), 4 slices per frame: CABAC Main profile,
        // no deblocking, temporal+spatial direct, B_8x8 sub-partitions.
        // Tests multi-slice B-frame decode with cross-slice boundary handling.
        decode_multiframe_and_compare("ms_cabac_b_test", 4, 64, 64);
    }

    #[test]
    fn test_high_p8x8_sub4x4() {
        // 64x64, 6 frames (I+P): High profile, preset slower with P_8x8
        // sub-4x4 partitions + 8x8dct. Tests noSubMbPartSizeLessThan8x8Flag:
        // transform_size_8x8_flag must NOT be read when P_8x8 has sub-4x4
        // sub-partitions.
        decode_multiframe_and_compare("high_p8x8_sub4x4_test", 6, 64, 64);
    }

    #[test]
    fn test_b_temporal_direct_8x8_inference() {
        // 64x64, 4 frames (I,B,B,P): CABAC Main, preset slower, direct=temporal.
        // Tests direct_8x8_inference_flag in temporal direct mode: co-located MV
        // must be read from the representative 4x4 block per 8x8 group, not from
        // each individual 4x4 block.
        decode_multiframe_and_compare("b_temporal_direct_test", 4, 64, 64);
    }

    #[test]
    fn test_high_b_slower() {
        // 64x64, 10 frames: High profile, preset slower, ref=2, bframes=2,
        // 8x8dct, no-deblock. Tests direct_8x8_inference_flag in BOTH temporal
        // and spatial direct modes, noSubMbPartSizeLessThan8x8Flag for
        // transform_size_8x8_flag, and B_8x8 with sub-partition types.
        decode_multiframe_and_compare("high_b_slower_test", 10, 64, 64);
    }

    #[test]
    fn test_high_cavlc_b() {
        // 64x64, 10 frames: CAVLC High profile with bframes=2, ref=2, 8x8dct,
        // all partitions, no-deblock. Validates CAVLC B-frame 8x8 transform path.
        decode_multiframe_and_compare("high_cavlc_b_test", 10, 64, 64);
    }

    #[test]
    fn test_ms_deblock_b_cabac() {
        // 64x64, 8 frames: CABAC Main profile with bframes=2, ref=2, 4 slices,
        // deblocking ON. Tests B-slice CABAC ref_idx context with direct-mode
        // neighbors, MV/MVD zeroing for inactive prediction lists, and
        // multi-slice deblocking.
        decode_multiframe_and_compare("ms_deblock_b_cabac_test", 8, 64, 64);
    }

    #[test]
    fn test_ms_cavlc_b() {
        // 64x64, 8 frames: CAVLC Main profile, bframes=2, ref=2, 4 slices,
        // no-deblock. Tests CAVLC multi-slice B-frame decode.
        decode_multiframe_and_compare("ms_cavlc_b_test", 8, 64, 64);
    }

    #[test]
    fn test_cavlc_deblock_pb() {
        // 64x64, 8 frames: CAVLC Main profile, bframes=1, ref=1,
        // deblocking ON. Tests CAVLC P+B with deblocking filter.
        decode_multiframe_and_compare("cavlc_deblock_pb_test", 8, 64, 64);
    }

    #[test]
    fn test_unaligned_resolution() {
        // 100x76, 6 frames: CABAC High profile, bframes=1, ref=1,
        // no-deblock. Tests non-16-aligned dimensions (coded 112x80).
        decode_multiframe_and_compare("unaligned_100x76_test", 6, 100, 76);
    }

    #[test]
    fn test_cabac_weighted_p() {
        // 64x64, 8 frames: CABAC Main profile, 100% weighted P (fading),
        // bframes=0, ref=2, no-deblock. Tests CABAC explicit weighted P-slice.
        decode_multiframe_and_compare("cabac_weighted_p_test", 8, 64, 64);
    }

    #[test]
    fn test_cavlc_i8x8() {
        // 64x64, 3 frames: CAVLC High profile, all-intra (keyint=1), 8x8dct,
        // no-deblock. Tests CAVLC I8x8 intra prediction with 8x8 transform.
        decode_multiframe_and_compare("cavlc_i8x8_test", 3, 64, 64);
    }

    #[test]
    fn test_cabac_b8x8_direct() {
        // 64x64, 8 frames: CABAC Main profile, constrained_intra_pred_flag=1,
        // bframes=2, ref=2, no-deblock. All-B_8x8 MBs with B_Direct_8x8
        // sub-partitions. Tests per-block direct flag for ref_idx CABAC context.
        decode_multiframe_and_compare("cabac_b8x8_direct_test", 8, 64, 64);
    }

    #[test]
    fn test_constrained_intra() {
        // 64x64, 8 frames: CABAC Main profile, constrained_intra_pred_flag=1,
        // bframes=1, ref=2, no-deblock. Tests that intra MBs in P/B slices
        // treat inter-predicted neighbors as unavailable (spec 8.3.1).
        decode_multiframe_and_compare("constrained_intra_test", 8, 64, 64);
    }

    #[test]
    fn test_high_preset_medium() {
        // 320x240, 30 frames: CABAC High profile, bframes=3, ref=4, 8x8dct
        // (92% intra, 98% inter), no-deblock. Large-resolution stress test
        // with all High profile features active.
        decode_multiframe_and_compare("high_preset_medium_test", 30, 320, 240);
    }

    #[test]
    fn test_high_deblock_medium() {
        // 320x240, 30 frames: CABAC High profile, bframes=3, ref=4, 8x8dct,
        // deblocking ON. Tests 8x8 transform deblocking (skip internal odd
        // edges per spec 8.7.2.1).
        decode_multiframe_and_compare("high_deblock_medium_test", 30, 320, 240);
    }

    #[test]
    fn test_jm_ltr_cavlc() {
        // 64x64, 8 frames: JM encoder, Baseline profile, CAVLC,
        // SetFirstAsLongTerm=1, ref=2. Tests MMCO long-term reference
        // (IDR marked as LT via long_term_reference_flag).
        decode_multiframe_and_compare("jm_ltr_cavlc_test", 8, 64, 64);
    }

    #[test]
    fn test_jm_ltr_cabac() {
        // 64x64, 8 frames: JM encoder, Main profile, CABAC,
        // SetFirstAsLongTerm=1, ref=2. Tests MMCO long-term reference
        // with CABAC entropy coding.
        decode_multiframe_and_compare("jm_ltr_cabac_test", 8, 64, 64);
    }

    #[test]
    fn test_jm_weighted_b_explicit() {
        // 64x64, 8 frames: JM encoder, Main profile, CABAC,
        // weighted_bipred_idc=1 (explicit weighted B), bframes=1.
        // Tests explicit weighted bi-prediction for B-slices.
        decode_multiframe_and_compare("jm_weighted_b_explicit_test", 8, 64, 64);
    }

    #[test]
    fn test_jm_ipcm_cavlc() {
        // 32x32, 4 frames: JM encoder, Baseline profile, CAVLC, QP=0,
        // I_PCM macroblocks with random content. Tests CAVLC I_PCM decode.
        decode_multiframe_and_compare("jm_ipcm_cavlc_test", 4, 32, 32);
    }

    #[test]
    fn test_jm_ipcm_cabac() {
        // 32x32, 4 frames: JM encoder, Main profile, CABAC, QP=0,
        // I_PCM macroblocks with random content. Tests CABAC I_PCM decode
        // with engine reinit and is_i16x16 context flag for I_PCM neighbors.
        decode_multiframe_and_compare("jm_ipcm_cabac_test", 4, 32, 32);
    }

    #[test]
    fn test_jm_poc_type1() {
        // 64x64, 6 frames: JM encoder, Baseline profile, CAVLC,
        // pic_order_cnt_type=1 (delta-based POC). Tests POC type 1 computation.
        decode_multiframe_and_compare("jm_poc_type1_test", 6, 64, 64);
    }

    #[test]
    fn test_jm_poc_type2() {
        // 64x64, 6 frames: JM encoder, Baseline profile, CAVLC,
        // pic_order_cnt_type=2 (frame_num-derived POC). Tests POC type 2 computation.
        decode_multiframe_and_compare("jm_poc_type2_test", 6, 64, 64);
    }

    #[test]
    fn test_jm_field_flat() {
        // 64x64 (combined), 1 frame: JM encoder, Main profile, CAVLC,
        // field pictures (field_pic_flag=1) with flat gray content (128).
        // Tests basic field picture decode, field combining, and deblocking.
        decode_multiframe_and_compare("jm_field_flat_test", 1, 64, 64);
    }

    #[test]
    fn test_jm_field_grad() {
        // 64x64 (combined), 1 frame: JM encoder, Main profile, CAVLC,
        // field pictures with vertical gradient content. QP=26.
        // Tests field coefficient scan order (spec Table 8-13) and
        // field picture deblocking.
        decode_multiframe_and_compare("jm_field_grad_test", 1, 64, 64);
    }

    #[test]
    fn test_jm_field_i() {
        // 64x64 (combined), 1 frame: JM encoder, Main profile, CAVLC,
        // field pictures (top=IDR I-slice, bottom=P-slice). QP=10, testsrc2 content.
        // Tests field P-slice MC referencing top field, including chroma field
        // MV offset for opposite-parity reference (spec 8.4.2.2).
        decode_multiframe_and_compare("jm_field_i_test", 1, 64, 64);
    }

    #[test]
    fn test_jm_field_chroma() {
        // 64x64 (combined), 1 frame: JM encoder, Main profile, CAVLC,
        // field pictures with non-trivial chroma content (U vertical gradient).
        // QP=10. Tests chroma MC with field parity offset — bottom field
        // chroma prediction from top field requires +2 eighth-pel vertical shift.
        decode_multiframe_and_compare("jm_field_chroma_test", 1, 64, 64);
    }

    #[test]
    fn test_jm_field_p() {
        // 64x64, 4 frames: JM encoder, Main profile, CAVLC,
        // multi-frame field pictures (all P-slices after IDR). QP=10.
        // Tests field-aware DPB reference list construction (spec 8.2.4.2.5),
        // sliding window for complementary field pairs, chroma field MV offset,
        // and field coefficient scan order across multiple frames.
        decode_multiframe_and_compare("jm_field_p_test", 4, 64, 64);
    }

    #[test]
    fn test_jm_field_cabac() {
        // 64x64 (combined), 1 frame: JM encoder, Main profile, CABAC,
        // field pictures (top=IDR I-slice, bottom=P-slice). QP=10.
        // Tests CABAC field-coded significance/last coefficient contexts
        // (ctxIdx 277+/338+) for field pictures via is_field_coded().
        decode_multiframe_and_compare("jm_field_cabac_test", 1, 64, 64);
    }

    /// Decode a multi-frame stream and compare output YUV SHA-256 hash.
    /// Used for large-resolution tests where storing the full reference YUV
    /// would be too expensive.
    fn decode_and_compare_hash(
        h264_name: &str,
        expected_frames: usize,
        expected_width: u32,
        expected_height: u32,
        expected_sha256: &str,
    ) {
        let h264_path = format!("{}/testdata/{}.h264", env!("CARGO_MANIFEST_DIR"), h264_name);
        let h264_data = std::fs::read(&h264_path)
            .unwrap_or_else(|e| panic!("failed to read {}: {}", h264_path, e));

        let nals = parse_annex_b(&h264_data);
        let mut decoder = Decoder::new();
        let mut frames = Vec::new();
        for nal in &nals {
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frames.push(f);
            }
        }
        if let Some(f) = decoder.flush() {
            frames.push(f);
        }
        assert_eq!(
            frames.len(),
            expected_frames,
            "expected {} frames",
            expected_frames
        );
        for f in &frames {
            assert_eq!(f.width, expected_width);
            assert_eq!(f.height, expected_height);
        }

        // Sort by POC for display-order comparison
        frames.sort_by_key(|f| f.pic_order_cnt);

        // Build output YUV and compute SHA-256.
        let mut output = Vec::new();
        for frame in &frames {
            output.extend_from_slice(&frame.y);
            output.extend_from_slice(&frame.u);
            output.extend_from_slice(&frame.v);
        }

        let hex = crate::sha256::sha256_hex(&output);
        assert_eq!(hex, expected_sha256, "SHA-256 mismatch for {}", h264_name);
    }

    #[test]
    fn test_crop_left_top() {
        // x264 128x96 progressive, cropped 16 px left, 32 px top and 8 px right with
        // h264_metadata; the display window starts at the left/top offset.
        // SHA-256 of ffmpeg's decode.
        decode_and_compare_hash(
            "crop_left_top",
            4,
            104,
            64,
            "6aafd150e5a3b37f80f93dbefa6f9bdc889b263a109b8e3610864ba92307e205",
        );
    }

    #[test]
    fn test_crop_mbaff() {
        // x264 128x96 MBAFF, cropped 16 px left, 16 px top and 16 px bottom (frame lines) with
        // h264_metadata; the display window starts at the left/top offset.
        // SHA-256 of ffmpeg's decode.
        decode_and_compare_hash(
            "crop_mbaff",
            6,
            112,
            64,
            "67d9b2f60df5f671aaafbb6efbaefdf4bf8b8640e0c2dbaf38b2c711d876e0c5",
        );
    }

    // Monochrome (4:0:0) streams from x264 (--output-csp i400), SHA-256 of
    // ffmpeg's decode: no chroma syntax, chroma planes mid-grey

    #[test]
    fn test_mono_x264_cavlc() {
        // CAVLC with B-pyramid, explicit weighted P (no chroma weights in
        // the table), 8x8 transform and the 4:0:0 CBP mapping
        decode_and_compare_hash(
            "mono_x264_cavlc",
            24,
            176,
            144,
            "726f959f217c4991af53594e60ebdfa066448761720761d53426d2e4582d13ef",
        );
    }

    #[test]
    fn test_mono_x264_cabac_mbaff() {
        // CABAC MBAFF with temporal direct and two slices per picture
        decode_and_compare_hash(
            "mono_x264_cabac_mbaff",
            24,
            176,
            144,
            "41c13cd124b65362a24a5fd3d60a19415ef703fb4db5bedfafa62e70afebb68d",
        );
    }

    // 4:2:2 streams from x264 (--output-csp i422), SHA-256 of ffmpeg's
    // yuv422p decode

    #[test]
    fn test_yuv422_x264_cavlc() {
        // CAVLC with B-pyramid, explicit weighted P and 8x8 transform: 2x4
        // chroma DC (nC -2 coeff_token and total_zeros tables), 8 AC blocks
        // per plane, quarter-sample vertical chroma MVs
        decode_and_compare_hash(
            "yuv422_x264_cavlc",
            24,
            176,
            144,
            "7a50ba6f3dbed359da6f5429a6e3cdfc958e0ec2fc2c6d903e00023de0bf21b9",
        );
    }

    #[test]
    fn test_yuv422_x264_cabac() {
        // CABAC, weighted P and B, two slices: chroma DC contexts for 8
        // coefficients
        decode_and_compare_hash(
            "yuv422_x264_cabac",
            24,
            176,
            144,
            "bcdc344e5bbd73673e74abc2ab9330881cf3f33d1bdc26a4896dc10107887b83",
        );
    }

    #[test]
    fn test_yuv422_x264_cabac_mbaff() {
        // CABAC MBAFF with temporal direct: field MB chroma (16 lines per
        // MB) and deblocking of mixed frame/field edges
        decode_and_compare_hash(
            "yuv422_x264_cabac_mbaff",
            24,
            176,
            144,
            "3cb0298c93aa9db69e0dfa9e1455e5441fcb21b6304f90d8f5c0b4b51562d004",
        );
    }

    #[test]
    fn test_yuv422_x264_cavlc_mbaff() {
        // CAVLC MBAFF with spatial direct and two slices: chroma nC
        // neighbours across frame/field pairs
        decode_and_compare_hash(
            "yuv422_x264_cavlc_mbaff",
            24,
            176,
            144,
            "abd5655addb8d6e84fa4e931edad80bc31d9fecdb64601d51f2b8a31604b9169",
        );
    }

    #[test]
    fn test_yuv422_x264_mbaff_constrained_intra() {
        // MBAFF with constrained intra prediction: 8x16 chroma DC with
        // half-available left columns
        decode_and_compare_hash(
            "yuv422_x264_mbaff_constrained_intra",
            24,
            176,
            144,
            "58a7e32def47df01ae875100005075c19a76b72807bf3e1b9ac6d90053ffaabf",
        );
    }

    #[test]
    fn test_yuv422_x264_crop_low_qp() {
        // 168x136 (cropped) at QP 10: large chroma DC levels and the QP+3
        // chroma DC scaling
        decode_and_compare_hash(
            "yuv422_x264_crop_low_qp",
            16,
            168,
            136,
            "c42b837c8570844db4dca38655a75ee9351402a278825d7ce932bc711c884f89",
        );
    }

    // 10-bit streams (High 10, High 4:2:2), SHA-256 of ffmpeg's yuv420p10le
    // (yuv422p10le) decode

    #[test]
    fn test_high10_420_32x32() {
        // 32x32 High 10 (x264): the smallest 10-bit stream, 2 bytes per sample
        // little-endian like FFmpeg's yuv420p10le
        decode_and_compare_hash(
            "high10_420_32x32",
            2,
            32,
            32,
            "1ec93bac92dc9198cd6459e4a702d43dc0c40d717b9f43ea1bda8d6222aa186c",
        );
    }

    #[test]
    fn test_high10_x264_cavlc() {
        // CAVLC with B-pyramid, explicit weighted P (offsets scaled by
        // 1 << (BitDepth - 8)) and 8x8 transform
        decode_and_compare_hash(
            "high10_x264_cavlc",
            24,
            176,
            144,
            "4d2fb330d92cd2a71c8cc35d04293629e9f401f9369ef5ec01a51d71af3894b0",
        );
    }

    #[test]
    fn test_high10_x264_cabac() {
        // CABAC, weighted P and B, 4 refs, two slices, rate control: mb_qp_delta
        // beyond the 8-bit range (QP_Y down to -12) and deblocking thresholds
        // scaled to 10 bits
        decode_and_compare_hash(
            "high10_x264_cabac",
            24,
            176,
            144,
            "95da8fa5e43627a7257f3d3410a7ebea409c7f831eda193679117f63d63680cd",
        );
    }

    #[test]
    fn test_high10_x264_cabac_mbaff() {
        // CABAC MBAFF with temporal direct: field MBs and mixed-edge deblocking
        decode_and_compare_hash(
            "high10_x264_cabac_mbaff",
            24,
            176,
            144,
            "9ecacbcb883b9a6c5e2462f6365bf886fa77159c1d331a4ec60d663696683af0",
        );
    }

    #[test]
    fn test_high10_yuv422_x264_cabac() {
        // High 4:2:2 at 10 bits: chroma QP'c with QpBdOffsetC
        decode_and_compare_hash(
            "high10_yuv422_x264_cabac",
            24,
            176,
            144,
            "d37fde80af657525c8c9bcfb941c3325f19f03bff5078335f230950c1f99b1c5",
        );
    }

    #[test]
    fn test_high10_mono_x264() {
        // Monochrome at 10 bits: chroma planes at 512
        decode_and_compare_hash(
            "high10_mono_x264",
            24,
            176,
            144,
            "660e8b7eff8fe11fcda860f2f2b49ee370620684877b6986f2424a67f5eef3e2",
        );
    }

    #[test]
    fn test_high10_x264_crop_low_qp() {
        // 168x136 (cropped) at QP 4: cropping in 2-byte samples, large levels
        decode_and_compare_hash(
            "high10_x264_crop_low_qp",
            16,
            168,
            136,
            "45f6189eacb56850e766168dfbb02ab64bd6351a00920216fe3d582f805ce392",
        );
    }

    // x264 --interlaced (MBAFF) streams, SHA-256 of ffmpeg's decode. Mixed
    // frame/field pairs exercise the spec Table 6-4 neighbours throughout.

    #[test]
    fn test_mbaff_x264_cavlc_p() {
        // Ultrafast CAVLC 128x96: P skip runs ending on a top MB (the field
        // flag read with the bottom MB applies to the skipped top MB), field
        // chroma MV offsets and the last row of the bottom field
        decode_and_compare_hash(
            "mbaff_x264_cavlc_p",
            3,
            128,
            96,
            "d8327b18175e2c0978c01ff73ee03a60305a941d56980c6bfa8c60b5a8759e6f",
        );
    }

    #[test]
    fn test_mbaff_x264_cabac_p() {
        // As above with CABAC: the bottom MB's skip flag and the field flag
        // are decoded ahead of a skipped top MB
        decode_and_compare_hash(
            "mbaff_x264_cabac_p",
            3,
            128,
            96,
            "d8327b18175e2c0978c01ff73ee03a60305a941d56980c6bfa8c60b5a8759e6f",
        );
    }

    #[test]
    fn test_mbaff_x264_cavlc_8x8() {
        // Medium CAVLC 128x96 with the 8x8 transform: deblocking skips the
        // inner edges of CAVLC 8x8 MBs
        decode_and_compare_hash(
            "mbaff_x264_cavlc_8x8",
            3,
            128,
            96,
            "786472f892fe99e4edf5b3202e792f45897d28dfef9e29c82a97903cc9469ac8",
        );
    }

    #[test]
    fn test_mbaff_x264_cavlc_b() {
        // Ultrafast CAVLC 176x144 with B-frames: field MBs read ref_idx over
        // twice the references and predict from fields
        decode_and_compare_hash(
            "mbaff_x264_cavlc_b",
            12,
            176,
            144,
            "9f5b727b3e50f8040ad0210cc271365ddc4dd0cbaca0be821decda00c070c520",
        );
    }

    #[test]
    fn test_mbaff_x264_bff() {
        // Medium CABAC 352x240 (16 rows cropped), bottom field first:
        // luma CBP contexts across mixed pairs, field 8x8 significance
        // contexts, implicit weights from field POCs, mixed-edge deblocking
        decode_and_compare_hash(
            "mbaff_x264_bff",
            14,
            352,
            240,
            "be6402d7a9dc4d4b0e249a2b2330e882d363b42c996191a22e5cf6576c38af31",
        );
    }

    #[test]
    fn test_mbaff_x264_cavlc_weighted() {
        // Medium CAVLC 352x240 with weighted P: CAVLC 8x8 field scan, intra
        // above-right of bottom field MBs, explicit weights of field refs
        decode_and_compare_hash(
            "mbaff_x264_cavlc_weighted",
            14,
            352,
            240,
            "c8f2561cff263e6e03f07b1302efd85df83f474208ca3e7f2577c823df65d6cb",
        );
    }

    #[test]
    fn test_mbaff_x264_temporal_slices() {
        // Medium CABAC 352x240, 4 slices, temporal direct: co-located MBs of
        // the other frame/field kind, field flag contexts at slice edges
        decode_and_compare_hash(
            "mbaff_x264_temporal_slices",
            14,
            352,
            240,
            "0a3e1140e92d2345c90e11e8ca80d8742d3289b63b0d7ab4c6e3fbefdca54bd5",
        );
    }

    #[test]
    fn test_mbaff_x264_intra_modes() {
        // CABAC 352x240 at QP 2: intra 4x4/8x8 mode prediction from the left
        // MB of a pair coded the other way
        decode_and_compare_hash(
            "mbaff_x264_intra_modes",
            7,
            352,
            240,
            "18a8f32c86f4e4d06d523ca9296e400f4f8bb3b6c41e3eee16664872d14e9bc4",
        );
    }

    #[test]
    fn test_crop_field() {
        // JM field pictures (jm_field_p_test), cropped 8 px left, 8 px top and 8 px right with
        // h264_metadata; the display window starts at the left/top offset.
        // SHA-256 of ffmpeg's decode.
        decode_and_compare_hash(
            "crop_field",
            4,
            48,
            56,
            "ea608973a2ca218e6365424268cfb1372bdd75570d33e2777bc252061b94b2c4",
        );
    }

    #[test]
    fn test_large_crop_right_bottom() {
        // 128x96 coded, cropped 32 px right and 32 px bottom (two
        // macroblocks' worth) with h264_metadata: the MB counts must come
        // from the SPS, not the cropped size. SHA-256 of ffmpeg's decode.
        decode_and_compare_hash(
            "large_crop_rb",
            4,
            96,
            64,
            "bba5410ded9f41488dd4c5cb90bca6bdf1a4be3d7151f32ada5464dcefbf66f7",
        );
    }

    #[test]
    fn test_x264_pyramid_weightp_sliced() {
        // 88x128 (cropped from 96 wide), 80 frames of x264 High: ref=5, bframes=3
        // with b-pyramid (reference B-frames), weightp=2 (P-frames list a picture
        // twice) and sliced threads (two slices a frame, deblocking mode 2), with
        // log2_max_frame_num=4. Trunk decodes it differently from ffmpeg; this is
        // the SHA-256 of ffmpeg's decode.
        decode_and_compare_hash(
            "x264_pyramid_weightp_sliced",
            80,
            88,
            128,
            "cfc769b9ba681ce87882b759745e6c766425b0507aea8485cde39c053f09823e",
        );
    }

    #[test]
    fn test_1080p() {
        // 1920x1080, 10 frames: mandelbrot source, x264 --preset medium,
        // CABAC, bframes=3, ref=2, no-deblock. 6 B-frames, 3 P-frames, 1 IDR.
        // Hash-based comparison to avoid storing 30MB reference YUV.
        decode_and_compare_hash(
            "1080p_test",
            10,
            1920,
            1080,
            "e795b2188acd5a6f4b819f588e388ab3af1357edb36a62a5f53ba24fbd9a57d4",
        );
    }

    #[test]
    fn test_1080p_deblock() {
        // 1920x1080, 10 frames: mandelbrot source, x264 --preset medium,
        // CABAC, bframes=3, ref=2, deblocking ON.
        decode_and_compare_hash(
            "1080p_deblock_test",
            10,
            1920,
            1080,
            "cb4ebf9c0e470717c7c2f0dd29f1afca172c362414803ee7a132844dd827e3f5",
        );
    }

    #[test]
    fn test_1080p_cavlc() {
        // 1920x1080, 10 frames: mandelbrot source, x264 --preset medium,
        // CAVLC, bframes=3, ref=2, no-deblock.
        decode_and_compare_hash(
            "1080p_cavlc_test",
            10,
            1920,
            1080,
            "d53999477dacff0905a38a3c1ff4e3ca210b634f968cf56c914b76a08eee99da",
        );
    }

    /// Verify that OrderedDecoder produces the same display-order output as
    /// manually decoding with Decoder + sorting by (idr_count, poc). Uses
    /// preset_medium (320x240, 60 frames, ref=4, bframes=3) which exercises
    /// B-frame reordering across multiple GOPs.
    #[test]
    fn test_ordered_decoder_matches_manual_sort() {
        let h264_path = format!("{}/testdata/preset_medium.h264", env!("CARGO_MANIFEST_DIR"));
        let h264_data = std::fs::read(&h264_path).unwrap();
        let nals = parse_annex_b(&h264_data);

        // Reference: manually decode + sort by (idr_count, poc)
        let mut decoder = Decoder::new();
        let mut idr_count: u32 = 0;
        let mut frames: Vec<(u32, i32, Frame)> = Vec::new();
        for nal in &nals {
            let is_idr = nal.nal_unit_type == NalUnitType::SliceIdr;
            if let Some(f) = decoder.decode_nal(nal).unwrap() {
                frames.push((idr_count, f.pic_order_cnt, f));
            }
            if is_idr {
                idr_count += 1;
            }
        }
        if let Some(f) = decoder.flush() {
            frames.push((idr_count, f.pic_order_cnt, f));
        }
        frames.sort_by_key(|(idr, poc, _)| (*idr, *poc));
        let manual_yuv: Vec<u8> = frames
            .iter()
            .flat_map(|(_, _, f)| {
                let mut v = Vec::new();
                v.extend_from_slice(&f.y);
                v.extend_from_slice(&f.u);
                v.extend_from_slice(&f.v);
                v
            })
            .collect();

        // OrderedDecoder: same NALs, automatic ordering
        let mut ordered = OrderedDecoder::new();
        let mut ordered_frames: Vec<Frame> = Vec::new();
        for nal in &nals {
            ordered_frames.extend(ordered.decode_nal(nal).unwrap());
        }
        ordered_frames.extend(ordered.flush());
        let ordered_yuv: Vec<u8> = ordered_frames
            .iter()
            .flat_map(|f| {
                let mut v = Vec::new();
                v.extend_from_slice(&f.y);
                v.extend_from_slice(&f.u);
                v.extend_from_slice(&f.v);
                v
            })
            .collect();

        assert_eq!(ordered_frames.len(), frames.len(), "frame count mismatch");
        assert_eq!(
            ordered_yuv, manual_yuv,
            "OrderedDecoder output differs from manual sort"
        );
    }

    fn is_slice_nal(nal: &NalUnit) -> bool {
        matches!(
            nal.nal_unit_type,
            NalUnitType::Slice | NalUnitType::SliceIdr
        )
    }

    fn picture_meta_for_nal(
        nal: &NalUnit,
        current_picture_meta: &mut Option<u64>,
        next_picture_meta: &mut u64,
    ) -> u64 {
        if is_slice_nal(nal) {
            let mut peek = BitstreamReader::new(&nal.rbsp);
            let first_mb = peek.read_ue().unwrap_or(0);
            if first_mb == 0 || current_picture_meta.is_none() {
                let meta = *next_picture_meta;
                *next_picture_meta += 1;
                *current_picture_meta = Some(meta);
            }
            current_picture_meta.expect("slice NAL should have picture metadata")
        } else {
            // Metadata passed for non-slice NALs is intentionally ignored.
            u64::MAX
        }
    }

    fn expected_metadata_by_poc(nals: &[NalUnit]) -> HashMap<i32, u64> {
        let mut decoder = Decoder::new();
        let mut expected = HashMap::new();
        let mut building_meta = None;
        let mut current_picture_meta = None;
        let mut next_picture_meta = 0;

        for nal in nals {
            let input_meta =
                picture_meta_for_nal(nal, &mut current_picture_meta, &mut next_picture_meta);
            let decoded = decoder.decode_nal(nal).unwrap();
            let finalized_previous = decoded.is_some();
            if let Some(frame) = decoded {
                let meta = building_meta
                    .take()
                    .expect("finalized frame should have delayed metadata");
                expected.insert(frame.pic_order_cnt, meta);
                current_picture_meta = if is_slice_nal(nal) {
                    Some(input_meta)
                } else {
                    None
                };
            }
            if is_slice_nal(nal) && (finalized_previous || building_meta.is_none()) {
                building_meta = Some(input_meta);
            }
        }

        if let Some(frame) = decoder.flush() {
            let meta = building_meta
                .take()
                .expect("flushed frame should have delayed metadata");
            expected.insert(frame.pic_order_cnt, meta);
        }

        expected
    }

    fn decode_ordered_with_metadata(h264_name: &str) -> Vec<(Frame, u64)> {
        let h264_path = format!("{}/testdata/{}.h264", env!("CARGO_MANIFEST_DIR"), h264_name);
        let h264_data = std::fs::read(&h264_path).unwrap();
        let nals = parse_annex_b(&h264_data);

        let mut decoder = OrderedDecoder::<u64>::new();
        let mut current_picture_meta = None;
        let mut next_picture_meta = 0;
        let mut frames = Vec::new();

        for nal in &nals {
            let meta = picture_meta_for_nal(nal, &mut current_picture_meta, &mut next_picture_meta);
            frames.extend(decoder.decode_nal_with_meta(nal, meta).unwrap());
        }
        frames.extend(decoder.flush_with_meta());

        let expected = expected_metadata_by_poc(&nals);
        assert_eq!(
            frames.len(),
            expected.len(),
            "metadata frame count mismatch"
        );
        for (frame, meta) in &frames {
            assert_eq!(
                Some(meta),
                expected.get(&frame.pic_order_cnt),
                "metadata mismatch for POC {}",
                frame.pic_order_cnt
            );
        }

        frames
    }

    #[test]
    fn test_ordered_decoder_metadata_p_only() {
        let frames = decode_ordered_with_metadata("p_multi_frame");
        let pocs: Vec<i32> = frames
            .iter()
            .map(|(frame, _)| frame.pic_order_cnt)
            .collect();
        let metas: Vec<u64> = frames.iter().map(|(_, meta)| *meta).collect();

        assert_eq!(pocs, vec![0, 2, 4, 6]);
        assert_eq!(metas, vec![0, 1, 2, 3]);
    }

    #[test]
    fn test_ordered_decoder_metadata_b_frames_not_off_by_one() {
        let frames = decode_ordered_with_metadata("b_l0_l1_test");
        let pocs: Vec<i32> = frames
            .iter()
            .map(|(frame, _)| frame.pic_order_cnt)
            .collect();
        let metas: Vec<u64> = frames.iter().map(|(_, meta)| *meta).collect();

        assert_eq!(pocs, vec![0, 2, 4, 6, 8]);
        assert_eq!(metas, vec![0, 2, 1, 4, 3]);
        assert_ne!(metas, vec![0, 1, 2, 3, 4]);
    }

    /// Decode an Annex B fuzz regression file. Must not panic.
    fn fuzz_decode_annex_b(name: &str) {
        let path = format!(
            "{}/testdata/fuzz_regressions/{}",
            env!("CARGO_MANIFEST_DIR"),
            name
        );
        let data = std::fs::read(&path).unwrap();
        let nals = parse_annex_b(&data);
        let mut decoder = Decoder::new();
        for nal in &nals {
            let _ = decoder.decode_nal(nal);
        }
        let _ = decoder.flush();
    }

    /// Decode an AVCC fuzz regression file. The first byte selects the
    /// avcC/sample split point, mirroring the `decode_avcc` fuzz target.
    /// Must not panic.
    fn fuzz_decode_avcc(name: &str) {
        let path = format!(
            "{}/testdata/fuzz_regressions/{}",
            env!("CARGO_MANIFEST_DIR"),
            name
        );
        let data = std::fs::read(&path).unwrap();
        if data.len() < 2 {
            return;
        }
        let split = (data[0] as usize).min(data.len() - 1);
        let avcc_box = &data[1..1 + split];
        let sample_data = &data[1 + split..];
        let cfg = match crate::nal::parse_avcc_config(avcc_box) {
            Ok(c) => c,
            Err(_) => return,
        };
        let mut decoder = Decoder::new();
        for nal in cfg.sps_nals.iter().chain(cfg.pps_nals.iter()) {
            let _ = decoder.decode_nal(nal);
        }
        for nal in crate::nal::parse_avcc(sample_data, cfg.length_size) {
            let _ = decoder.decode_nal(&nal);
        }
        let _ = decoder.flush();
    }

    // --- Unsupported formats ---

    /// Every slice of an unsupported stream fails with `Unsupported` (no
    /// wrong pictures), while its SPS still parses for `parse_sps_info`.
    #[test]
    fn test_unsupported_formats_are_rejected() {
        for (name, what) in [
            ("unsupported_444", "4:4:4 chroma"),
            ("unsupported_420_9bit", "bit depth other than 8 or 10"),
            ("unsupported_lossless", "lossless (transform bypass) coding"),
        ] {
            let path = format!("{}/testdata/{}.h264", env!("CARGO_MANIFEST_DIR"), name);
            let data = std::fs::read(&path).unwrap();
            let nals = parse_annex_b(&data);
            let sps = nals
                .iter()
                .find(|n| n.nal_unit_type == NalUnitType::Sps)
                .expect("stream has an SPS");
            assert!(crate::nal::parse_sps_info(sps).is_ok(), "{name}: SPS info");

            let mut decoder = OrderedDecoder::new();
            let mut slices = 0;
            for nal in &nals {
                let is_slice = matches!(
                    nal.nal_unit_type,
                    NalUnitType::Slice | NalUnitType::SliceIdr
                );
                match decoder.decode_nal(nal) {
                    Err(DecodeError::Unsupported(msg)) if is_slice => {
                        assert_eq!(msg, what, "{name}");
                        slices += 1;
                    }
                    Ok(frames) if !is_slice => assert!(frames.is_empty()),
                    other => panic!("{name}: unexpected {:?}", other.map(|f| f.len())),
                }
            }
            assert!(slices > 0, "{name}: no slices");
            assert!(decoder.flush().is_empty(), "{name}: produced frames");
        }
    }

    // --- Fuzz regression tests ---
    // Each test replays a crash input found by libFuzzer and verifies no panic.

    /// Empty ref_pic_list underflow (decode_cabac.rs / decode_cavlc.rs)
    #[test]
    fn test_fuzz_regression_empty_ref_list_no_panic() {
        fuzz_decode_annex_b("decode_annex_b_subtract_overflow.h264");
    }

    /// cabac_init_idc out of range (cabac.rs / slice.rs)
    #[test]
    fn test_fuzz_regression_cabac_init_idc_out_of_range() {
        fuzz_decode_avcc("decode_avcc_cabac_init_idc_oob.bin");
    }

    /// CABAC reader init past end of buffer (cabac.rs)
    #[test]
    fn test_fuzz_regression_cabac_init_past_end() {
        fuzz_decode_avcc("decode_avcc_cabac_init_oob.bin");
    }

    /// CAVLC coefficient position underflow (cavlc.rs)
    #[test]
    fn test_fuzz_regression_cavlc_pos_underflow() {
        fuzz_decode_annex_b("decode_annex_b_cavlc_pos_underflow.h264");
    }

    /// log2_weight_denom shift overflow (slice.rs)
    #[test]
    fn test_fuzz_regression_weight_denom_shift_overflow() {
        fuzz_decode_avcc("decode_avcc_weight_denom_overflow.bin");
    }

    /// ref_pic_safe empty list underflow (mv_pred.rs)
    #[test]
    fn test_fuzz_regression_ref_pic_safe_empty_list() {
        fuzz_decode_annex_b("decode_annex_b_ref_pic_safe_empty.h264");
    }

    /// Temporal direct mode empty L1 list (slice_context.rs)
    #[test]
    fn test_fuzz_regression_temporal_direct_empty_l1() {
        fuzz_decode_avcc("decode_avcc_temporal_direct_empty_l1.bin");
    }

    /// RPLM pic_num modular arithmetic underflow (dpb.rs)
    #[test]
    fn test_fuzz_regression_rplm_pic_num_underflow() {
        fuzz_decode_annex_b("decode_annex_b_rplm_pic_num_underflow.h264");
    }

    /// Dequant multiply overflow (residual.rs / neighbor.rs)
    #[test]
    fn test_fuzz_regression_dequant_mul_overflow() {
        fuzz_decode_avcc("decode_avcc_dequant_mul_overflow.bin");
    }

    /// Deblock QP average add overflow (deblock.rs)
    #[test]
    fn test_fuzz_regression_deblock_qp_overflow() {
        fuzz_decode_avcc("decode_avcc_deblock_qp_overflow.bin");
    }

    /// MC output buffer overrun from malformed block size (inter_pred.rs)
    #[test]
    fn test_fuzz_regression_mc_output_overrun() {
        fuzz_decode_annex_b("decode_annex_b_mc_output_overrun.h264");
    }

    /// SPS crop offset subtraction underflow (sps.rs)
    #[test]
    fn test_fuzz_regression_sps_crop_underflow() {
        fuzz_decode_avcc("decode_avcc_sps_crop_underflow.bin");
    }

    /// CABAC I_PCM frame buffer index out of bounds (decode_cabac.rs:2934)
    #[test]
    fn test_fuzz_regression_cabac_ipcm_frame_overrun() {
        fuzz_decode_annex_b("bug15_cabac_ipcm_frame_overrun.bin");
    }

    /// Divide by zero when coded width is zero (decoder.rs:357)
    #[test]
    fn test_fuzz_regression_divide_by_zero_coded_width() {
        fuzz_decode_avcc("bug16_divide_by_zero_coded_width.bin");
    }

    /// CABAC I_PCM in P/B-slice frame buffer overrun (decode_cabac.rs:797)
    #[test]
    fn test_fuzz_regression_cabac_ipcm_pb_frame_overrun() {
        fuzz_decode_annex_b("cabac_ipcm_pb_frame_overrun.bin");
    }

    /// Divide by zero when coded width is zero — variant 2 (decoder.rs:357)
    #[test]
    fn test_fuzz_regression_divide_by_zero_coded_width_2() {
        fuzz_decode_avcc("decode_avcc_divide_by_zero_2.bin");
    }

    /// SPS width() multiply overflow (sps.rs:124)
    #[test]
    fn test_fuzz_regression_sps_width_overflow() {
        fuzz_decode_avcc("decode_avcc_sps_width_overflow.bin");
    }

    /// Chroma MC ref_plane index out of bounds (inter_pred.rs:813)
    #[test]
    fn test_fuzz_regression_chroma_mc_ref_plane_overrun() {
        fuzz_decode_annex_b("chroma_mc_ref_plane_overrun.bin");
    }

    /// Deblock filter frame buffer overrun (deblock.rs:543)
    #[test]
    fn test_fuzz_regression_deblock_frame_overrun() {
        fuzz_decode_avcc("decode_avcc_deblock_overrun.bin");
    }

    /// CABAC reinit index out of bounds (cabac.rs:219)
    #[test]
    fn test_fuzz_regression_cabac_reinit_overrun() {
        fuzz_decode_annex_b("cabac_reinit_overrun.bin");
    }

    /// CAVLC B sub_mb_type table overrun (decode_cavlc.rs:448)
    #[test]
    fn test_fuzz_regression_cavlc_b_sub_mb_type_overrun() {
        fuzz_decode_annex_b("cavlc_b_sub_mb_type_overrun.bin");
    }

    /// first_mb_in_slice exceeds total MBs (decoder.rs:754)
    #[test]
    fn test_fuzz_regression_first_mb_overrun() {
        fuzz_decode_avcc("decode_avcc_first_mb_overrun.bin");
    }

    /// POC LSB shift overflow (dpb.rs:329)
    #[test]
    fn test_fuzz_regression_poc_shift_overflow() {
        fuzz_decode_avcc("decode_avcc_poc_shift_overflow.bin");
    }

    /// Frame crop slice overrun (decoder.rs:368)
    #[test]
    fn test_fuzz_regression_crop_overrun() {
        fuzz_decode_avcc("decode_avcc_crop_overrun.bin");
    }

    /// max_pic_num shift overflow (decoder.rs:426)
    #[test]
    fn test_fuzz_regression_frame_num_shift_overflow() {
        fuzz_decode_avcc("decode_avcc_frame_num_shift_overflow.bin");
    }

    /// Deblock multiply overflow (deblock.rs:113)
    #[test]
    fn test_fuzz_regression_deblock_mul_overflow() {
        fuzz_decode_avcc("decode_avcc_deblock_mul_overflow.bin");
    }

    /// Continuation slice with SPS dimension mismatch (decoder.rs:763)
    #[test]
    fn test_fuzz_regression_continuation_mismatch() {
        fuzz_decode_avcc("decode_avcc_continuation_mismatch.bin");
    }

    /// SPS scaling list delta add overflow (sps.rs:396)
    #[test]
    fn test_fuzz_regression_scaling_list_overflow() {
        fuzz_decode_avcc("decode_avcc_scaling_list_overflow.bin");
    }

    /// Dequant DC multiply overflow (residual.rs:150)
    #[test]
    fn test_fuzz_regression_dequant_dc_mul_overflow() {
        fuzz_decode_avcc("decode_avcc_dequant_dc_mul_overflow.bin");
    }

    /// POC MSB subtract overflow (dpb.rs:338)
    #[test]
    fn test_fuzz_regression_poc_msb_sub_overflow() {
        fuzz_decode_avcc("decode_avcc_poc_msb_sub_overflow.bin");
    }

    /// 8x8 IDCT subtract overflow (residual.rs:272)
    #[test]
    fn test_fuzz_regression_idct8x8_sub_overflow() {
        fuzz_decode_annex_b("idct8x8_sub_overflow.bin");
    }

    /// 4x4 IDCT add overflow (residual.rs:77)
    #[test]
    fn test_fuzz_regression_idct4x4_add_overflow() {
        fuzz_decode_avcc("decode_avcc_idct4x4_add_overflow.bin");
    }

    /// POC type 1 cycle multiply overflow (dpb.rs:378)
    #[test]
    fn test_fuzz_regression_poc_type1_mul_overflow() {
        fuzz_decode_avcc("decode_avcc_poc_type1_mul_overflow.bin");
    }

    /// SPS cropping larger than a macroblock: MB counts were derived from the
    /// cropped size, so the picture buffer was too small (slice_context.rs).
    #[test]
    fn test_fuzz_regression_large_crop_mb_dims() {
        fuzz_decode_avcc("decode_avcc_large_crop_mb_dims.bin");
    }

    /// Motion vector predictor + difference overflowing i16 in CAVLC P_8x8
    /// (decode_cavlc.rs). Spec 8.4.1 defines the sum modulo 2^16, so it wraps.
    #[test]
    fn test_fuzz_regression_cavlc_mv_add_overflow() {
        fuzz_decode_avcc("decode_avcc_cavlc_mv_add_overflow.bin");
    }

    /// Field-pair combine with mismatched field geometry (decoder.rs:451)
    #[test]
    fn test_fuzz_regression_field_pair_mismatch() {
        fuzz_decode_avcc("decode_avcc_field_pair_mismatch.bin");
    }

    /// MBAFF CAVLC test (64x64, 6-frame, interlaced, CAVLC, frame-coded pairs)
    #[test]
    fn test_mbaff_cavlc() {
        decode_multiframe_and_compare("mbaff_cavlc_test", 6, 64, 64);
    }

    /// MBAFF CAVLC P-frames with complex content (64x64, 8 frames, testsrc2)
    #[test]
    fn test_mbaff_p_cavlc_8f() {
        decode_multiframe_and_compare("mbaff_p_cavlc_8f_test", 8, 64, 64);
    }

    /// MBAFF High profile CAVLC with 8x8 transform (64x64, 6 frames, testsrc2)
    #[test]
    fn test_mbaff_high_cavlc() {
        decode_multiframe_and_compare("mbaff_high_cavlc_test", 6, 64, 64);
    }

    /// MBAFF CABAC I-frame (32x32, 1 frame, testsrc2, High profile)
    #[test]
    fn test_mbaff_cabac_i() {
        decode_multiframe_and_compare("mbaff_cabac_i_test", 1, 32, 32);
    }

    /// MBAFF CABAC I-frame 64x64 (1 frame, testsrc2, High profile)
    #[test]
    fn test_mbaff_cabac_64() {
        decode_multiframe_and_compare("mbaff_cabac_64_test", 1, 64, 64);
    }

    /// MBAFF CABAC P-frames (64x64, 5 frames, testsrc2, keyint=5)
    #[test]
    fn test_mbaff_cabac_p() {
        decode_multiframe_and_compare("mbaff_cabac_p_test", 5, 64, 64);
    }

    /// MBAFF CABAC B-frames (64x64, 8 frames, testsrc2, bframes=2 ref=2)
    #[test]
    fn test_mbaff_cabac_b() {
        decode_multiframe_and_compare("mbaff_cabac_b_test", 8, 64, 64);
    }

    /// MBAFF CAVLC B-frames (64x64, 8 frames, testsrc2, bframes=2 ref=2)
    #[test]
    fn test_mbaff_cavlc_b() {
        decode_multiframe_and_compare("mbaff_cavlc_b_test", 8, 64, 64);
    }

    /// MBAFF CAVLC deblocking (64x64, 8 frames, Main profile, P-only, deblock ON)
    #[test]
    fn test_mbaff_deblock_cavlc() {
        decode_multiframe_and_compare("mbaff_deblock_cavlc_test", 8, 64, 64);
    }

    /// MBAFF CABAC deblocking with B-frames (64x64, 8 frames, Main profile, bframes=2 ref=2)
    #[test]
    fn test_mbaff_deblock_cabac() {
        decode_multiframe_and_compare("mbaff_deblock_cabac_test", 8, 64, 64);
    }

    /// MBAFF High profile with 8x8 DCT + deblocking + B-frames (64x64, 8 frames)
    #[test]
    fn test_mbaff_high_deblock() {
        decode_multiframe_and_compare("mbaff_high_deblock_test", 8, 64, 64);
    }

    /// MBAFF field-coded I-frames (64x64, 3 frames, all-field-coded pairs, keyint=1)
    #[test]
    fn test_mbaff_field_i() {
        decode_multiframe_and_compare("mbaff_field_i_test", 3, 64, 64);
    }

    /// MBAFF field-coded P-frames CAVLC (64x64, 4 frames, all-field-coded pairs)
    #[test]
    fn test_mbaff_field_p() {
        decode_multiframe_and_compare("mbaff_field_p_test", 4, 64, 64);
    }

    /// MBAFF field-coded CABAC (64x64, 4 frames, all-field-coded pairs, Main profile)
    #[test]
    fn test_mbaff_field_cabac() {
        decode_multiframe_and_compare("mbaff_field_cabac_test", 4, 64, 64);
    }

    /// MBAFF field-coded High profile CAVLC with 8x8 DCT (64x64, 4 frames, all-field-coded)
    #[test]
    fn test_mbaff_field_high() {
        decode_multiframe_and_compare("mbaff_field_high_test", 4, 64, 64);
    }
}
