"""The public datasets that InfraBlend reads: address, licence, citation and expected contents.

One table for `infrablend fetch` and for the dataset cards. Facts that
were not verified on the files themselves are marked in `licence_note`, or by `checked=False`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

PAPER_BIBTEX = """\
@misc{barisickulas-unlocking,
  title  = {Unlocking Thermal Aerial Imaging: Synthetic Enhancement of {UAV} Datasets},
  author = {Barisic Kulas, Antonella and Jurasovic, Andreja and Bogdan, Stjepan},
  url    = {https://github.com/larics/thermal_aerial_synthetic}
}"""
"""The paper that InfraBlend implements; its text names neither journal nor year."""


@dataclass(frozen=True)
class Licence:
    """A licence: `id` as on the Hugging Face hub, name for people, address of its text (empty if none)."""

    id: str
    name: str
    url: str = ""


CC_BY_4 = Licence("cc-by-4.0", "CC BY 4.0", "https://creativecommons.org/licenses/by/4.0/")
CDLA_PERMISSIVE_1 = Licence(
    "cdla-permissive-1.0",
    "Community Data License Agreement - Permissive 1.0",
    "https://cdla.dev/permissive-1-0/",
)
MIT = Licence("mit", "MIT License", "https://opensource.org/license/mit")
APACHE_2 = Licence("apache-2.0", "Apache License 2.0", "https://www.apache.org/licenses/LICENSE-2.0")
CC0_1 = Licence("cc0-1.0", "CC0 1.0", "https://creativecommons.org/publicdomain/zero/1.0/")
UNKNOWN = Licence("unknown", "unknown")


@dataclass(frozen=True)
class Archive:
    """One file of a dataset.

    Attributes:
        part: Its name for `--part`.
        file: Name of the file.
        url: Where it can be fetched by a program; empty if it must be fetched by hand.
        into: Subfolder of the dataset that receives the content; empty for the dataset's own folder. Folders that
            contain nothing but one other folder are left out.
        size_bytes: Exact size, None if it is not known or not constant.
        sha256: None if it is not known or not constant.
        unpacked_bytes: Roughly what it needs unpacked, for the check of free space.
        commit: Commit of the repository that the archive was made from; git writes it into its archives.
        counts: Files by glob pattern below `into`.
        lists: Lengths of lists in JSON files: file -> key -> length.
        wanted: False if it is fetched only when its part is named.
        checked: False if sizes and counts come from others; a difference is then a warning only.
    """

    part: str
    file: str
    url: str = ""
    into: str = ""
    size_bytes: int | None = None
    sha256: str | None = None
    unpacked_bytes: int = 0
    commit: str | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    lists: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    wanted: bool = True
    checked: bool = True


@dataclass(frozen=True)
class Source:
    """A public dataset.

    Attributes:
        name: Of the dataset and of its format here.
        title: As its authors write it.
        page: Where people find it.
        licence: Of the data; `UNKNOWN` if none is stated.
        attribution: Whom to name.
        citation: BibTeX of its paper.
        archives: Its files.
        licence_note: What to know about the licence.
        by_hand: How to get it where a program cannot.
        limits: What users of the data must know.
    """

    name: str
    title: str
    page: str
    licence: Licence
    attribution: str
    citation: str
    archives: tuple[Archive, ...]
    licence_note: str = ""
    by_hand: str = ""
    limits: tuple[str, ...] = ()


_HIT_UAV_COMMIT = "f8100db7ce3ab602005dd9f32854bb57d4de9b87"
_HIT_UAV_SPLITS = {"train": (2029, 17628), "val": (290, 2460), "test": (579, 4811)}

HIT_UAV = Source(
    name="hit-uav",
    title="HIT-UAV: A high-altitude infrared thermal dataset for Unmanned Aerial Vehicle-based object detection",
    page="https://github.com/suojiashun/HIT-UAV-Infrared-Thermal-Dataset",
    licence=CC_BY_4,
    attribution="Jiashun Suo, Tianyi Wang, Xingzhou Zhang, Haiyang Chen, Wei Zhou, Weisong Shi",
    citation="""\
@article{suo-hit-uav,
  title   = {{HIT-UAV}: A high-altitude infrared thermal dataset for Unmanned Aerial Vehicle-based object detection},
  author  = {Suo, Jiashun and Wang, Tianyi and Zhang, Xingzhou and Chen, Haiyang and Zhou, Wei and Shi, Weisong},
  journal = {Scientific Data},
  volume  = {10},
  pages   = {227},
  year    = {2023},
  doi     = {10.1038/s41597-023-02066-6}
}""",
    archives=(
        Archive(
            part="all",
            file=f"HIT-UAV-{_HIT_UAV_COMMIT[:12]}.zip",
            url="https://codeload.github.com/suojiashun/HIT-UAV-Infrared-Thermal-Dataset/zip/" + _HIT_UAV_COMMIT,
            unpacked_bytes=900_000_000,
            commit=_HIT_UAV_COMMIT,
            # GitHub packs on every request, so the archive has no stable digest; its contents have.
            counts={
                "LICENSE": 1,
                **{
                    f"{form}/{s}/*.jpg": n
                    for form in ("normal_json", "rotate_json")
                    for s, (n, _) in _HIT_UAV_SPLITS.items()
                },
                **{f"{form}/JPEGImages/*.jpg": 2898 for form in ("normal_xml", "rotate_xml")},
                **{f"{form}/Annotations/*.xml": 2898 for form in ("normal_xml", "rotate_xml")},
            },
            lists={
                f"{form}/annotations/{s}.json": {"images": images, key: boxes}
                for form, key in (("normal_json", "annotation"), ("rotate_json", "annotations"))
                for s, (images, boxes) in _HIT_UAV_SPLITS.items()
            },
        ),
    ),
    limits=(
        "HIT-UAV's published split is random over frames, not over scenes: 525 of its 579 test images have a training "
        "image at most five frame numbers away. Scores on it flatter; hold out scenes by capture date to avoid that.",
        "48 boxes labelled Car in the frames 1_130_90_0_04053 to 04077 are people, and not every person is labelled.",
        "The pictures are 8-bit, contrast-normalised by the camera: grey levels are not temperatures.",
    ),
)

_LILA = "https://lilawildlife.blob.core.windows.net/lila-wildlife/conservationdrones/v01/"

BIRDSAI = Source(
    name="birdsai",
    title="BIRDSAI (Conservation Drones)",
    page="https://lila.science/datasets/conservationdrones",
    licence=CDLA_PERMISSIVE_1,
    licence_note="As others quote the dataset's page; read the page yourself before you publish.",
    attribution="Elizabeth Bondi, Raghav Jain, Palash Aggrawal, Saket Anand, Robert Hannaford, Ashish Kapoor, "
    "Jim Piavis, Shital Shah, Lucas Joppa, Bistra Dilkina, Milind Tambe",
    citation="""\
@inproceedings{bondi-birdsai,
  title     = {{BIRDSAI}: A Dataset for Detection and Tracking in Aerial Thermal Infrared Videos},
  author    = {Bondi, Elizabeth and Jain, Raghav and Aggrawal, Palash and Anand, Saket and Hannaford, Robert and
               Kapoor, Ashish and Piavis, Jim and Shah, Shital and Joppa, Lucas and Dilkina, Bistra and Tambe, Milind},
  booktitle = {IEEE/CVF Winter Conference on Applications of Computer Vision (WACV)},
  pages     = {1747--1756},
  year      = {2020}
}""",
    archives=tuple(
        Archive(
            part=part,
            file=f"conservation_drones_{part}_real.zip",
            url=f"{_LILA}conservation_drones_{part}_real.zip",
            into=f"{part.title()}Real",
            size_bytes=size,
            unpacked_bytes=unpacked,
            counts={"annotations/*.csv": tables, "images/*/*.jpg": pictures},
            checked=False,
        )
        for part, size, unpacked, tables, pictures in (
            ("train", 2_271_707_323, 2_400_000_000, 32, 40_661),
            ("test", 1_761_788_520, 1_900_000_000, 16, 21_336),
        )
    ),
    limits=(
        "BIRDSAI says neither camera pitch nor altitude: inserted objects were seen from a pitch that was assumed.",
        "Frames of one video resemble each other; the published split is by video, so keep videos together.",
    ),
)

_MONET_SHARE = "https://fbk-my.sharepoint.com/:f:/g/personal/poiesi_fbk_eu/"

MONET = Source(
    name="monet",
    title="MONET: Multimodal drone thermal dataset recorded in rural scenarios",
    page="https://github.com/fabiopoiesi/monet_dataset",
    licence=CC_BY_4,
    attribution="Riz et al.",
    citation="""\
@inproceedings{riz-monet,
  title     = {The {MONET} dataset: Multimodal drone thermal dataset recorded in rural scenarios},
  author    = {Riz and others},
  booktitle = {IEEE/CVF Conference on Computer Vision and Pattern Recognition (CVPR) Workshops},
  year      = {2023},
  note      = {arXiv:2304.05417}
}""",
    archives=tuple(Archive(part=p, file=f"monet_{p}.zip", into=p) for p in ("train", "val", "test")),
    by_hand="Open the three shared folders in a browser, choose Download, and keep the zip files:\n"
    f"  train {_MONET_SHARE}Ep7luptKPA1Po6cp4EKLrm4BsgbZGrZjDnynPwvrv3NGOA?e=bcPyYu\n"
    f"  val   {_MONET_SHARE}EllAoY1Kp0dGrJMaPEp9sQwBMlf7VUJ3eOooQ_u5W3b4QQ\n"
    f"  test  {_MONET_SHARE}EpDYrUNh-QJEpFWU7GE_BGYBDixyG85Q3Fj4AKlwtZHCIw",
    limits=(
        "Part of MONET's frames have no camera metadata; they are no backgrounds unless a pitch is given.",
        "InfraBlend's reader was written from MONET's documentation, not from its files.",
    ),
)

WISARD = Source(
    name="wisard",
    title="WiSARD: A Labeled Visual and Thermal Image Dataset for Wilderness Search and Rescue",
    page="https://sites.google.com/uw.edu/wisard",
    licence=MIT,
    licence_note="As others quote the dataset's page; the archive holds no licence text. Read the page yourself.",
    attribution="Daniel Broyles, Christopher R. Hayner, Karen Leung",
    citation="""\
@inproceedings{broyles-wisard,
  title     = {{WiSARD}: A Labeled Visual and Thermal Image Dataset for Wilderness Search and Rescue},
  author    = {Broyles, Daniel and Hayner, Christopher R. and Leung, Karen},
  booktitle = {IEEE/RSJ International Conference on Intelligent Robots and Systems (IROS)},
  pages     = {9467--9474},
  year      = {2022},
  doi       = {10.1109/IROS47612.2022.9981298}
}""",
    archives=(
        Archive(part="all", file="WiSARDv1.zip"),
        Archive(part="sample", file="wisard-sample.zip", size_bytes=1_018_780_195, wanted=False, checked=False),
    ),
    by_hand="Google Drive asks before it hands out large files. In a browser:\n"
    "  all (40.5 GB)   https://drive.google.com/open?id=1PKjGCqUszHH1nMbXUBTwPSDqRabAt_ht\n"
    "  sample (1.0 GB) https://drive.google.com/open?id=1uSgMXuZGVCrWM_151UcykyHejxxaVHOo",
    limits=(
        "WiSARD says neither camera pitch nor altitude: inserted objects were seen from a pitch that was assumed.",
        "Some WiSARD folders are not labelled, one stops half-way, and _FLIR_ clips carry a burnt-in logo.",
        "There is no published split; keep clips, better flight days, together.",
    ),
)

WIT_UAS = Source(
    name="wit-uas",
    title="WIT-UAS: A Wildland-fire Infrared Thermal Dataset to Detect Crew Assets From Aerial Views",
    page="https://github.com/castacks/WIT-UAS-Dataset",
    licence=UNKNOWN,
    licence_note="The authors state no licence: treat it as all rights reserved, and ask them before you publish "
    "anything made from it.",
    attribution="Jong et al.",
    citation="""\
@inproceedings{jong-wit-uas,
  title     = {{WIT-UAS}: A Wildland-fire Infrared Thermal Dataset to Detect Crew Assets From Aerial Views},
  author    = {Jong and others},
  booktitle = {IEEE/RSJ International Conference on Intelligent Robots and Systems (IROS)},
  year      = {2023},
  note      = {arXiv:2312.09159}
}""",
    archives=(Archive(part="all", file="WIT-UAS-Image.zip"),),
    by_hand="In a browser: https://drive.google.com/file/d/13wUe6-g5nTDPgCYNLRAw8CXKID6JpRfF",
    limits=(
        "WIT-UAS's published split takes frames out of every ten consecutive ones: neighbours are in different "
        "splits. Regroup by run.",
        "WIT-UAS says neither camera pitch nor altitude: inserted objects were seen from a pitch that was assumed.",
    ),
)

DUT_ANTI_UAV = Source(
    name="dut-anti-uav",
    title="DUT Anti-UAV",
    page="https://github.com/wangdongdut/DUT-Anti-UAV",
    licence=APACHE_2,
    licence_note="The repository's licence; the archives hold none, and where the pictures were collected is not said.",
    attribution="Jie Zhao, Jingshu Zhang, Dongdong Li, Dong Wang",
    citation="""\
@article{zhao-dut-anti-uav,
  title   = {Vision-based Anti-{UAV} Detection and Tracking},
  author  = {Zhao, Jie and Zhang, Jingshu and Li, Dongdong and Wang, Dong},
  journal = {IEEE Transactions on Intelligent Transportation Systems},
  year    = {2022},
  note    = {arXiv:2205.10851}
}""",
    archives=tuple(
        Archive(
            part=part,
            file=f"{part}.zip",
            into=part,
            size_bytes=size,
            sha256=digest,
            counts={"img/*.jpg": pictures, "xml/*.xml": pictures},
            checked=False,
        )
        for part, size, pictures, digest in (
            ("train", 744_616_230, 5200, "14f927290556df60e23cedfa80dffc10dc21e4a3b6843e150cfc49644376eece"),
            ("val", 372_283_691, 2600, "238be0ceb3e7c5be6711ee3247e49df2750d52f91f54f5366c68bebac112ebf8"),
            ("test", 271_153_425, 2200, "a671989a01cff98c684aeb084e59b86f4152c50499d86152eb970a9fc7fb1cbe"),
        )
    ),
    by_hand="Google Drive asks before it hands out large files. In a browser:\n"
    "  train https://drive.google.com/open?id=1RVsSGPUKTdmoyoPTBTWwroyulLek1eTj\n"
    "  val   https://drive.google.com/open?id=1333uEQfGuqTKslRkkeLSCxylh6AQ0X6n\n"
    "  test  https://drive.google.com/open?id=1L1zeW1EMDLlXHClSDcCjl3rs_A6sVai0",
    limits=("Visible light, not thermal.", "Neighbouring numbers are likely frames of one video."),
)

BAMBI = Source(
    name="bambi",
    title="The BAMBI Dataset: Multimodal Nadir UAV-Recordings of Forest Wildlife",
    page="https://github.com/bambi-eco/Dataset",
    licence=CC_BY_4,
    licence_note="The version environment-nc is CC BY-NC 4.0; it is not read.",
    attribution="Christoph Praschl, Hugo Markoff, Anna Maschek, Wolfram Jantsch, Stephanie Wohlfahrt, Horst Leitner, "
    "Sara Beery, Michael \u00d8rsted, David C. Schedl",
    citation="""\
@misc{praschl-bambi,
  title        = {The {BAMBI} Dataset: Multimodal Nadir {UAV}-Recordings of Forest Wildlife},
  author       = {Praschl, Christoph and Markoff, Hugo and Maschek, Anna and Jantsch, Wolfram and Wohlfahrt, Stephanie
                  and Leitner, Horst and Beery, Sara and {\\O}rsted, Michael and Schedl, David C.},
  year         = {2026},
  howpublished = {CV4Animals Workshop at the IEEE/CVF Conference on Computer Vision and Pattern Recognition (CVPR)}
}""",
    archives=(Archive(part="flight", file="flight_146.zip"),),
    by_hand="The flights are on Zenodo, an archive of up to 1.5 GB each. With the authors' script:\n"
    "  git clone https://github.com/bambi-eco/Dataset bambi-tools\n"
    "  python bambi-tools/download_from_zenodo.py --split test --unzip\n"
    "or in a browser, part 1 of 8: https://doi.org/10.5281/zenodo.18692354",
    limits=(
        "BAMBI states no height above the ground: its poses have the altitude above the sea.",
        "Boxes between annotated key frames are interpolated; only key frames are read unless you ask for all.",
        "Keep the frames of a flight, better those of a place, in one split.",
    ),
)

DRONE_VEHICLE = Source(
    name="drone-vehicle",
    title="DroneVehicle: Drone-based RGB-Infrared Cross-Modality Vehicle Detection",
    page="https://github.com/VisDrone/DroneVehicle",
    licence=UNKNOWN,
    licence_note="The authors state no licence: ask them before you publish anything made from it.",
    attribution="Yiming Sun, Bing Cao, Pengfei Zhu, Qinghua Hu",
    citation="""\
@article{sun-drone-vehicle,
  title   = {Drone-based {RGB}-Infrared Cross-Modality Vehicle Detection via Uncertainty-Aware Learning},
  author  = {Sun, Yiming and Cao, Bing and Zhu, Pengfei and Hu, Qinghua},
  journal = {IEEE Transactions on Circuits and Systems for Video Technology},
  year    = {2022},
  doi     = {10.1109/TCSVT.2022.3168279}
}""",
    archives=tuple(Archive(part=p, file=f"{p}.zip", into=p) for p in ("train", "val", "test")),
    by_hand="The authors' page links three shared folders that ask for an access code, which is on the page, too.",
    limits=(
        "DroneVehicle states neither camera pitch nor altitude of its pictures.",
        "Neighbouring numbers are likely frames of one flight, and no sequence is stated.",
        "InfraBlend's reader was written from published descriptions, not from the files.",
    ),
)

ANTI_UAV = Source(
    name="anti-uav",
    title="Anti-UAV: A Large-Scale Benchmark for Vision-based UAV Tracking (Anti-UAV300, 410 and 600)",
    page="https://github.com/ZhaoJ9014/Anti-UAV",
    licence=MIT,
    licence_note="The licence of the project's repository; the archives hold none. Anti-UAV410 states none.",
    attribution="Nan Jiang, Kuiran Wang, Xiaoke Peng, Xuehui Yu, Qiang Wang, Junliang Xing, Guorong Li, Jian Zhao, "
    "Guodong Guo, Zhenjun Han",
    citation="""\
@article{jiang-anti-uav,
  title   = {{Anti-UAV}: A Large-Scale Benchmark for Vision-Based {UAV} Tracking},
  author  = {Jiang, Nan and Wang, Kuiran and Peng, Xiaoke and Yu, Xuehui and Wang, Qiang and Xing, Junliang and
             Li, Guorong and Zhao, Jian and Guo, Guodong and Han, Zhenjun},
  journal = {IEEE Transactions on Multimedia},
  year    = {2021}
}""",
    archives=(Archive(part="all", file="Anti-UAV.zip"),),
    by_hand="Links of all versions are on the pages https://github.com/ZhaoJ9014/Anti-UAV and, for Anti-UAV410,\n"
    "https://github.com/HwangBo94/Anti-UAV410",
    limits=(
        "The cameras are on the ground and look up: no backgrounds for views from above.",
        "InfraBlend's reader was written from published descriptions, not from the files.",
    ),
)

HALMSTAD = Source(
    name="halmstad",
    title="Halmstad drone detection dataset: Real-Time Drone Detection and Tracking With Visible, Thermal and Acoustic "
    "Sensors",
    page="https://github.com/DroneDetectionThesis/Drone-detection-dataset",
    licence=CC0_1,
    attribution="Fredrik Svanstr\u00f6m, Cristofer Englund, Fernando Alonso-Fernandez",
    citation="""\
@inproceedings{svanstrom-halmstad,
  title     = {Real-Time Drone Detection and Tracking With Visible, Thermal and Acoustic Sensors},
  author    = {Svanstr{\\"o}m, Fredrik and Englund, Cristofer and Alonso-Fernandez, Fernando},
  booktitle = {International Conference on Pattern Recognition (ICPR)},
  year      = {2020}
}""",
    archives=(Archive(part="all", file="Drone-detection-dataset.zip"),),
    by_hand="git clone https://github.com/DroneDetectionThesis/Drone-detection-dataset (the thermal part is 67 MB)",
    limits=(
        "The camera is on the ground and looks up: no backgrounds for views from above.",
        "There is no published split; keep the frames of a clip together.",
        "Boxes were drawn by hand and are loose; clips of two drones at once cannot be decoded.",
    ),
)

SOURCES: tuple[Source, ...] = (
    HIT_UAV, BIRDSAI, MONET, WISARD, WIT_UAS, DUT_ANTI_UAV, BAMBI, DRONE_VEHICLE, ANTI_UAV, HALMSTAD,
)  # fmt: skip
"""All datasets, in the order of `infrablend fetch --list`."""


def find_source(name: str) -> Source | None:
    """Return the source of that name, or None."""
    return next((s for s in SOURCES if s.name == name), None)
