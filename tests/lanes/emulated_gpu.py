"""A driver without a GPU: it compiles the text of kernels for this processor, and runs thread after thread."""

import ctypes
from enum import Enum
from types import SimpleNamespace

import llvmlite.binding as llvm
import numpy as np

from erosion.lanes.gpu import Gpu
from erosion.lanes.machine import this_machine
from erosion.lanes.thread_ir import PROCESSOR
from erosion.lanes.writer import ENTRY

Result = Enum("Result", "CUDA_SUCCESS CUDA_ERROR_NOT_READY CUDA_ERROR_OUT_OF_MEMORY CUDA_ERROR_NO_DEVICE")


class EmulatedDriver:
    """The functions of NVIDIA's driver that `Gpu` calls; what was never copied or written is 255 in every byte.

    Args:
        processors: of the GPU.
        memory: bytes that it has.
        failing: a function of the driver that finds no device.
    """

    CUdevice_attribute = SimpleNamespace(CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT=0)
    CUstream_flags = SimpleNamespace(CU_STREAM_NON_BLOCKING=SimpleNamespace(value=1))

    def __init__(self, processors=1, memory=2**30, failing=""):
        self.processors, self.memory, self.failing = processors, memory, failing
        self.texts, self.kept, self.launches = [], {}, 0

    def __getattr__(self, name):
        """Functions whose answer does not matter."""
        if not name.startswith("cu"):
            raise AttributeError(name)
        if name == self.failing:
            return lambda *arguments: (Result.CUDA_ERROR_NO_DEVICE,)
        answer = {"cuDeviceGetCount": 1, "cuDeviceGetAttribute": self.processors}.get(name, 1)
        return lambda *arguments: (Result.CUDA_SUCCESS, answer)

    def cuModuleLoadData(self, code):  # noqa: N802
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self.texts.append(code[:-1].decode())
        cpu, features = this_machine()
        machine = llvm.Target.from_default_triple().create_target_machine(cpu=cpu, features=features, opt=0, jit=True)
        module = llvm.parse_assembly(self.texts[-1])
        module.triple, module.data_layout = machine.triple, str(machine.target_data)
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        engine.add_object_file(llvm.ObjectFileRef.from_data(machine.emit_object(module)))
        engine.finalize_object()
        return Result.CUDA_SUCCESS, engine

    def cuModuleGetFunction(self, engine, name):  # noqa: N802
        assert name == ENTRY.encode()
        run = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 9)(engine.get_function_address(ENTRY))
        return Result.CUDA_SUCCESS, SimpleNamespace(engine=engine, run=run)

    def cuMemAlloc(self, size):  # noqa: N802
        if size > self.memory:
            return Result.CUDA_ERROR_OUT_OF_MEMORY, None
        array = np.full(size + 512, 255, np.uint8)
        address = -(-array.ctypes.data // 256) * 256
        self.kept[address] = array
        return Result.CUDA_SUCCESS, address

    cuMemAllocHost = cuMemAlloc  # noqa: N815

    def cuMemFree(self, address):  # noqa: N802
        del self.kept[address]
        return (Result.CUDA_SUCCESS,)

    cuMemFreeHost = cuMemFree  # noqa: N815

    def cuMemcpyHtoDAsync(self, to, from_, size, stream):  # noqa: N802
        ctypes.memmove(to, from_, size)
        return (Result.CUDA_SUCCESS,)

    cuMemcpyDtoHAsync = cuMemcpyHtoDAsync  # noqa: N815

    def cuLaunchKernel(self, function, blocks, _, __, block, *rest):  # noqa: N802
        self.launches += 1
        (values, types) = rest[4]
        assert len(values) == len(types) == 7
        for thread in range(min(blocks * block, 24)):  # the first take all lanes
            function.run(*values, thread, blocks * block)
        return (Result.CUDA_SUCCESS,)

    def cuStreamQuery(self, stream):  # noqa: N802
        return (Result.CUDA_SUCCESS,)


def emulated_gpu(**options):
    """A GPU whose kernels this processor runs."""
    return Gpu(EmulatedDriver(**options), PROCESSOR, lambda text: text)
