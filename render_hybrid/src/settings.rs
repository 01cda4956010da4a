//! What a user can choose. Everything here but [`RendererOptions`] may change from frame to frame; every field says what
//! more of it costs. A pixel is a function of (scene, pixel, these settings), but where [`VplOptions::reuse`] asks for history.

/// Who makes direct and indirect light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RasterLane {
    /// wgpu on a real GPU, the CPU twin on a software adapter or none.
    #[default]
    Auto,
    /// The CPU twin: the same bits on every machine.
    Cpu,
    /// wgpu; an error where there is no adapter.
    Gpu,
}

/// Who traces mirrors and glass. All show the same picture within a stated tolerance (docs/gpu-tracer.md).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Tracer {
    /// What was fastest on this adapter when it was measured, the CPU on a software adapter or with the CPU's raster lane.
    #[default]
    Auto,
    /// All cores.
    Cpu,
    /// A compute pass over the CPU's own trees; wants the GPU's raster lane.
    Gpu,
    /// The same in a fragment pass that reads textures alone.
    GpuFragment,
    /// The adapter's ray tracing hardware.
    RayQuery,
}

impl Tracer {
    /// All but `Auto`, in the order in which equals are preferred.
    pub const ALL: [Self; 4] = [Self::RayQuery, Self::Gpu, Self::GpuFragment, Self::Cpu];

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
            Self::GpuFragment => "gpu-fragment",
            Self::RayQuery => "rayquery",
        }
    }
}

/// Shadows of point, spot and directional lights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shadows {
    /// Filtered variance shadow maps (Donnelly & Lauritzen 2006).
    #[default]
    Moments,
    /// Depth bounds over the part of the map through which the light's disc is seen prove pixels fully lit or dark; rays as
    /// in `Traced` decide elsewhere.
    Certified,
    /// Rays: one for a light of radius 0, else [`RenderSettings::shadow_samples`] on its disc.
    Traced,
    /// None.
    Off,
}

/// What is stored and filtered in shadow maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShadowFilter {
    /// z and z² (Donnelly & Lauritzen 2006): bleeds light where occluders overlap.
    Vsm,
    /// Moments of two exponential warps of z (Lauritzen & McCool 2008): little bleeding, twice the memory and filtering.
    #[default]
    Evsm4,
}

/// Whether glass throws shadows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GlassShadows {
    /// Glass blocks light like matter.
    #[default]
    Opaque,
    /// Light passes through glass as if it were not there.
    Clear,
}

/// Visibility of virtual point lights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VplShadows {
    /// None (the thesis): fast, leaks light behind occluders.
    Off,
    /// A small octahedral depth map each, made by rays: a few texels per pixel and VPL.
    #[default]
    Maps,
    /// One ray per pixel and VPL: slow, and the truth.
    Traced,
}

/// Kind of each mesh's own tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BlasKind {
    /// Wide bounding volume hierarchy.
    #[default]
    Bvh,
    /// The thesis's SAH kd-tree with short-stack traversal.
    KdTree,
}

/// SIMD level of the CPU's kernels. All give the same bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SimdLevel {
    /// The best that the processor has.
    #[default]
    Auto,
    /// Whatever the compile target guarantees (SSE2, NEON).
    Portable,
    /// 256-bit x86.
    Avx2,
    /// 512-bit x86.
    Avx512,
}

/// Shadow moments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MomentOptions {
    /// What the maps hold.
    pub filter: ShadowFilter,
    /// Texels a side of a spot or directional light's map. Higher: finer contacts, quadratic cost.
    pub size: u32,
    /// Texels a side of each of a point light's six faces.
    pub face_size: u32,
    /// Penumbrae widen with the distance from occluder to receiver, as the light's disc wants. Costs about half again the time of
    /// maps and direct light on the CPU; without, every edge is about two texels soft.
    pub soft: bool,
    /// Floor on σ², in units of squared normalised depth, > 0. Higher: less acne, softer contacts.
    pub min_variance: f32,
    /// Visibility below this is cut to 0 and the rest stretched, in [0, 1). Higher: less light bleeding, thinner penumbrae.
    pub light_bleed_reduction: f32,
}

impl Default for MomentOptions {
    fn default() -> Self {
        Self {
            filter: ShadowFilter::default(),
            size: 1024,
            face_size: 512,
            soft: false,
            min_variance: 2e-7,
            light_bleed_reduction: 0.2,
        }
    }
}

/// Where VPLs lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VplPlacement {
    /// Where light paths land: a VPL a landing.
    #[default]
    Paths,
    /// On a pattern of places of their own on every instance, each lit by sixteen landings of light paths ([`crate::trace::surfels`]):
    /// less noise, and no jumps where a path leaves a moving body. There is no choice among [`VplOptions::candidates`] then.
    /// Where so few places would not cover the scene's surfaces (very many bodies), where these are folded like an atrium's, where
    /// visibility is off, and under a cap on rays: as [`Self::Paths`].
    Surfels,
}

/// What rays from the places of the grid bring of what stands close to them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NearField {
    /// Nothing: corners are too dark, since the geometry term is bounded.
    #[default]
    Off,
    /// The light that [`VplOptions::geometry_term_max`] cuts off: 9 rays a place, no longer than that light reaches.
    Light,
    /// That, and occluders too close for the VPLs' maps: 64 rays, and more VPLs at what they meet.
    Full,
}

/// Virtual point lights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VplOptions {
    /// Number of VPLs of all bounces together. Cost is linear in it; error falls with it.
    pub count: u32,
    /// Candidates for each VPL, 1 to 64: those that give most to the picture are kept ([`Self::count`] of them). Higher: less
    /// error, most where lights shine on much that is not seen; 2 to 3 rays a candidate, and VPLs are made anew where the
    /// camera moves. 1: all are kept, whatever the camera sees.
    pub candidates: u32,
    /// Where they lie.
    pub placement: VplPlacement,
    /// Diffuse reflections before the last one to the camera path, ≥ 1.
    pub bounces: u32,
    /// Upper bound of cos·cos/d² in 1/m², as a multiple of 1/(scene's bounding radius)²; `None`: no bound (unbiased, with
    /// bright spots near VPLs). Higher: less bias, more spots.
    pub geometry_term_max: Option<f32>,
    /// Their visibility.
    pub shadows: VplShadows,
    /// Texels a side of a VPL's map where `shadows` are maps: 16, 32 or 64. Higher: finer contacts, harder edges, quadratic
    /// cost in rays and memory (4 bytes a texel).
    pub map_size: u32,
    /// Side n of the blocks of pixels over which VPLs are interleaved: each pixel is lit by 1/n² of them and a filter that
    /// keeps to surfaces puts them together. 1 (full evaluation), 2 or 4. Higher: 1/n² of the cost, indirect light blurred
    /// over n pixels, noise along edges. Hits in mirrors evaluate fully.
    pub interleave: u32,
    /// Pixels between the places of the picture where VPLs are evaluated, and between which their light is carried along
    /// surfaces: 1 (every pixel), 2, 4, 8 or 16. Higher: 1/n² of the cost, shadows of VPLs soft to n pixels. Less where it
    /// would leave fewer than 64 places along the shorter side. Not where visibility is traced or VPLs are interleaved.
    pub spacing: u32,
    /// What rays from each place of the grid find close to it. Higher: lighter corners, then darker contacts, more rays. No
    /// effect where there is no grid or a cap on rays. On the CPU in both lanes, with `Full` all of the grid.
    pub near_field: NearField,
    /// VPLs, without visibility, that light what mirrors and glass show, a set of their own; 0: the same as what is seen
    /// directly. Cost is linear in it, for each hit. With [`Self::spacing`] they also light pixels that the grid cannot tell.
    pub mirrored: u32,
    /// Most VPLs that are made anew in a frame whose lights or bodies have moved; the others stay where they were as long as
    /// their light sees them, and their flux follows it. 0: off, a frame is the same whatever came before it. Lower: fewer
    /// rays for maps, but light lags behind what moved quickly; at least one light path is begun anew. A frame then depends
    /// on the frames before it. Not for the set of mirrors, which has no maps; VPLs are made on the CPU, where light paths land.
    pub reuse: u32,
}

impl Default for VplOptions {
    fn default() -> Self {
        Self {
            count: 256,
            candidates: 1,
            placement: VplPlacement::Paths,
            bounces: 2,
            geometry_term_max: Some(100.0),
            shadows: VplShadows::Maps,
            map_size: 32,
            interleave: 1,
            spacing: 1,
            near_field: NearField::Off,
            mirrored: 0,
            reuse: 0,
        }
    }
}

/// One frame's choices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Picture width in pixels, 1..=16384.
    pub width: u32,
    /// Picture height in pixels, 1..=16384.
    pub height: u32,
    /// Shadow method.
    pub shadows: Shadows,
    /// Rays per light of non-zero radius where shadows are traced. Higher: smoother penumbrae, linear cost.
    pub shadow_samples: u32,
    /// Whether glass throws shadows.
    pub glass_shadows: GlassShadows,
    /// Shadow-map options.
    pub moments: MomentOptions,
    /// Indirect light; `None`: off.
    pub vpl: Option<VplOptions>,
    /// Trace mirrors and glass. Off: those pixels keep only their matte share.
    pub traced: bool,
    /// Most interfaces (mirror or glass) on a path from the camera, ≥ 1. Higher: deeper nesting; cost up to 2^depth in glass.
    pub max_depth: u32,
    /// Rays whose weight falls below it (greatest channel) end. Lower: exact, dearer.
    pub min_weight: f32,
    /// Most rays a frame: a quarter of it makes VPLs and their maps, fewer of them where it must be; what lights and VPLs
    /// leave goes to mirrors and glass, whose rays of least weight end first ([`crate::trace::budget`]); `None`: no cap.
    /// Lower: fewer VPLs, shallower and dimmer reflections. A capped frame has the same bits everywhere.
    pub ray_budget: Option<u64>,
    /// Tile side in pixels of the CPU's work; never changes the picture.
    pub tile: u32,
    /// Seed of sampling patterns.
    pub seed: u32,
    /// Keep every layer beside the final picture. Costs memory traffic, and read-back on the GPU lane.
    pub keep_layers: bool,
    /// Measure each GPU pass and note when each stage ran. Free where the adapter has timestamps; elsewhere it waits after
    /// each pass.
    pub time_passes: bool,
    /// GPU lane: CPU and GPU work on two frames at once, so that a frame takes as long as the slower of both and not their
    /// sum. Costs one frame of latency: each call shows the picture that the call before would have shown without
    /// ([`crate::FrameStats::latency_frames`]). The first call of a size, and calls that keep layers, show their own.
    pub double_buffered: bool,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self::preset(Preset::Interactive)
    }
}

/// Bundles of settings, named by cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preset {
    /// 16 VPLs without shadows, depth 4: editing.
    Draft,
    /// 400 VPLs on surfels (where these do not cover the scene: of 1,600 candidates) with shadow maps on a grid of the
    /// picture and the light close to its places, 64 without in mirrors, filtered shadows, depth 8: play.
    #[default]
    Interactive,
    /// 6,144 VPLs on surfels (elsewhere: of four times as many candidates), with shadow maps and the near field, certified soft shadows, depth 16:
    /// stills.
    High,
}

impl RenderSettings {
    /// The settings of a preset at 1024 x 1024.
    pub fn preset(preset: Preset) -> Self {
        let base = Self {
            width: 1024,
            height: 1024,
            shadows: Shadows::Moments,
            shadow_samples: 16,
            glass_shadows: GlassShadows::Opaque,
            moments: MomentOptions::default(),
            vpl: Some(VplOptions::default()),
            traced: true,
            max_depth: 8,
            min_weight: 1.0 / 512.0,
            ray_budget: None,
            tile: 32,
            seed: 0,
            keep_layers: false,
            time_passes: false,
            double_buffered: false,
        };
        match preset {
            Preset::Draft => Self {
                moments: MomentOptions { size: 512, face_size: 256, ..base.moments },
                // Hard shadows of so few VPLs would be worse than none.
                vpl: Some(VplOptions { count: 16, bounces: 1, shadows: VplShadows::Off, ..VplOptions::default() }),
                max_depth: 4,
                min_weight: 1.0 / 64.0,
                ..base
            },
            // Each pixel would take 16 times as long, and each hit in a mirror 60 times (docs/light.md).
            // With so few VPLs a higher bound shows as bright spots around each, at no gain in FLIP, and maps of twice the side
            // cost 2 to 5 ms a frame for 0.005 to 0.008 of FLIP, on light paths 13 ms. Rays worth less than 1/50 are a third of
            // the donut's time and nothing against the reference (docs/light.md).
            Preset::Interactive => Self {
                vpl: Some(VplOptions {
                    count: 400,
                    candidates: 4,
                    placement: VplPlacement::Surfels,
                    geometry_term_max: Some(30.0),
                    map_size: 16,
                    spacing: 16,
                    near_field: NearField::Light,
                    mirrored: 64,
                    ..VplOptions::default()
                }),
                min_weight: 1.0 / 50.0,
                ..base
            },
            Preset::High => Self {
                shadows: Shadows::Certified,
                vpl: Some(VplOptions {
                    count: 6144,
                    candidates: 4,
                    placement: VplPlacement::Surfels,
                    bounces: 3,
                    geometry_term_max: Some(400.0),
                    map_size: 64,
                    spacing: 2,
                    near_field: NearField::Full,
                    ..VplOptions::default()
                }),
                max_depth: 16,
                min_weight: 1.0 / 4096.0,
                ..base
            },
        }
    }

    /// First field that is out of its range, in words.
    pub fn invalid(&self) -> Option<String> {
        if self.width == 0 || self.height == 0 || self.width > 16384 || self.height > 16384 {
            return Some(format!("size {}x{} is outside 1x1 to 16384x16384", self.width, self.height));
        }
        if self.max_depth == 0 || self.max_depth > 64 {
            return Some(format!("depth {} is outside 1 to 64", self.max_depth));
        }
        if !(self.tile.is_power_of_two() && (4..=256).contains(&self.tile)) {
            return Some(format!("tile {} is not a power of two from 4 to 256", self.tile));
        }
        if self.shadow_samples == 0 || self.shadow_samples > 4096 {
            return Some(format!("{} shadow samples are outside 1 to 4096", self.shadow_samples));
        }
        if !(self.min_weight >= 0.0 && self.min_weight.is_finite()) {
            return Some(format!("a least ray weight of {} is not a number from 0 up", self.min_weight));
        }
        let m = self.moments;
        if !(16..=8192).contains(&m.size) || !(16..=8192).contains(&m.face_size) {
            return Some(format!("moment maps of {} and {} texels are outside 16 to 8192", m.size, m.face_size));
        }
        if !(m.min_variance > 0.0 && m.min_variance.is_finite() && (0.0..1.0).contains(&m.light_bleed_reduction)) {
            return Some("min_variance must be over 0 and light_bleed_reduction in [0, 1)".into());
        }
        if let Some(v) = self.vpl {
            if !(1..=64).contains(&v.candidates) {
                return Some(format!("{} candidates for a VPL: 1 to 64", v.candidates));
            }
            if v.count == 0 || v.count > 1 << 20 || v.bounces == 0 || v.bounces > 64 || v.bounces > v.count {
                return Some(format!(
                    "{} VPLs over {} bounces: 1 to 1048576 VPLs, 1 to 64 bounces",
                    v.count, v.bounces
                ));
            }
            if ![1, 2, 4].contains(&v.interleave) {
                return Some(format!("VPLs interleaved over {} pixels: 1, 2 or 4", v.interleave));
            }
            if ![1, 2, 4, 8, 16].contains(&v.spacing) {
                return Some(format!("VPLs evaluated every {} pixels: 1, 2, 4, 8 or 16", v.spacing));
            }
            if v.mirrored > 1 << 20 {
                return Some(format!("{} VPLs for mirrors: 0 to 1048576", v.mirrored));
            }
            if v.reuse > 1 << 20 {
                return Some(format!("{} VPLs made anew a frame: 0 to 1048576", v.reuse));
            }
            if ![16, 32, 64].contains(&v.map_size) {
                return Some(format!("VPL maps of {} texels: 16, 32 or 64", v.map_size));
            }
            if v.geometry_term_max.is_some_and(|b| b.is_nan() || b < 0.0) {
                return Some("the bound of the VPLs' geometry term must be a number from 0 up".into());
            }
        }
        None
    }
}

/// What a renderer is made with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RendererOptions {
    /// Raster lane.
    pub raster: RasterLane,
    /// Tracer of mirrors and glass.
    pub tracer: Tracer,
    /// Worker threads; 0: one a processor. Never changes the picture.
    pub threads: usize,
    /// SIMD level. Never changes the picture.
    pub simd: SimdLevel,
    /// Tree of each mesh. Never changes the picture.
    pub blas: BlasKind,
}
