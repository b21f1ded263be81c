"""Dr.Jit and its back ends: find one, feed it, and launch kernels without compiling them again.

A kernel takes 10 to 500 ms to compile and often less than one to run. So everything that changes between frames has
to be data. Python takes half the time of a small frame to describe it to Dr.Jit; that is done once, where it can be.

gate       one thread at a time; what is freed, and when
backend    choose a Mitsuba variant that works
gpus       several GPUs, one for each process
trial      compare frames of a GPU with those of the CPU
types      protocols for what Mitsuba and Dr.Jit return
llvm       find an LLVM library that Dr.Jit can use
choice     one of several objects for each lane
transfer   numbers to the device, results back
replay     record stages once, launch them again
blocks     small frames on all cores
gradients  derivatives of formulas
profile    count kernels, measure memory
"""
