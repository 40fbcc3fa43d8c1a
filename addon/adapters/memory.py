"""Memory of this process and of the computer, in bytes, on the three systems.

None stands for what the system does not tell. macOS tells the highest use of a process, not the present one.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path


def current_memory() -> int | None:
    """Memory the process holds now."""
    if sys.platform == "win32":
        return _windows_process_memory()[0]
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    except OSError:  # not Linux
        return None
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def peak_memory() -> int | None:
    """Most memory the process has held since it started."""
    if sys.platform == "win32":
        return _windows_process_memory()[1]
    import resource  # there is none under Windows

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024  # bytes there, kibibytes elsewhere


def physical_memory() -> int | None:
    """Memory of the computer."""
    if sys.platform == "win32":
        return _windows_physical_memory()
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):  # a Unix that lacks the name
        return None


def give_back_freed() -> None:
    """Hand memory that was freed back to the system, where its allocator would keep it: glibc's.

    Its heap shrinks from the end only: one small array that is still in use there holds all that was freed before it,
    and each thread has a heap of its own. Takes some milliseconds.
    """
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # musl and others have none
    if trim is not None:
        trim(0)


class MemoryMeter:
    """Highest memory above that at the start, over a stretch of work.

    The system's own peak is exact, but counts from the start of the process: it serves when the work raised it.
    Otherwise the samples do, which may miss a short peak.
    """

    def __init__(self) -> None:
        self._peak_before = peak_memory() or 0
        self._start = current_memory()
        self._highest = self._start or 0

    def sample(self) -> None:
        """Look now."""
        self._highest = max(self._highest, current_memory() or 0)

    @property
    def above_start(self) -> int:
        """Bytes held now above those at the start, 0 where the system does not tell."""
        return (current_memory() or 0) - (self._start or 0)

    def result(self) -> tuple[int, int]:
        """(peak of the process, peak above the start) in bytes."""
        self.sample()
        peak = peak_memory() or self._highest
        start = self._peak_before if self._start is None else self._start
        highest = peak if peak > self._peak_before else self._highest
        return peak, max(highest - start, 0)


def _windows_process_memory() -> tuple[int | None, int | None]:
    import ctypes
    from ctypes import wintypes

    size = ctypes.c_size_t

    class Counters(ctypes.Structure):
        _fields_ = (
            ("cb", wintypes.DWORD),
            ("PageFaultCount", wintypes.DWORD),
            ("PeakWorkingSetSize", size),
            ("WorkingSetSize", size),
            ("QuotaPeakPagedPoolUsage", size),
            ("QuotaPagedPoolUsage", size),
            ("QuotaPeakNonPagedPoolUsage", size),
            ("QuotaNonPagedPoolUsage", size),
            ("PagefileUsage", size),
            ("PeakPagefileUsage", size),
        )

    counters = Counters(cb=ctypes.sizeof(Counters))
    process = ctypes.windll.kernel32.GetCurrentProcess
    process.restype = wintypes.HANDLE
    query = ctypes.windll.psapi.GetProcessMemoryInfo
    query.argtypes = (wintypes.HANDLE, ctypes.POINTER(Counters), wintypes.DWORD)
    if not query(process(), ctypes.byref(counters), counters.cb):
        return None, None
    return counters.WorkingSetSize, counters.PeakWorkingSetSize


def _windows_physical_memory() -> int | None:
    import ctypes

    class Status(ctypes.Structure):
        _fields_ = (
            ("dwLength", ctypes.c_uint32),
            ("dwMemoryLoad", ctypes.c_uint32),
            ("ullTotalPhys", ctypes.c_uint64),
            ("ullAvailPhys", ctypes.c_uint64),
            ("ullTotalPageFile", ctypes.c_uint64),
            ("ullAvailPageFile", ctypes.c_uint64),
            ("ullTotalVirtual", ctypes.c_uint64),
            ("ullAvailVirtual", ctypes.c_uint64),
            ("ullAvailExtendedVirtual", ctypes.c_uint64),
        )

    status = Status(dwLength=ctypes.sizeof(Status))
    if not ctypes.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):
        return None
    return status.ullTotalPhys
