// Every function of the device library in one kernel: it is all there, and it
// asks the driver for nothing but memory.
//
// RUN: tai-translate --tai-to-ptx --device-target=sm_75 %s -o %t.75.ptx
// RUN: tai-translate --tai-to-ptx --device-target=sm_90 %s -o %t.90.ptx
// RUN: FileCheck %s --check-prefixes=CHECK,SM75 < %t.75.ptx
// RUN: FileCheck %s --check-prefixes=CHECK,SM90 < %t.90.ptx
// RUN: tai-translate --tai-to-device-llvmir --device-target=emulated %s \
// RUN:   | FileCheck %s --check-prefix=EMULATED

// SM75: .version 7.0
// SM75: .target sm_75
// SM90: .version 8.1
// SM90: .target sm_90
// CHECK-DAG: .extern .func {{.*}}malloc
// CHECK-DAG: .extern .func free
// CHECK-NOT: .extern .func
// CHECK: .entry everything

// Fences are written out around the grid's barrier.
// CHECK: fence.acq_rel.gpu
// CHECK: atom.relaxed.gpu.add.u32
// CHECK: ld.acquire.gpu.u32

// Reductions end in an operation that the memory has, where it has one.
// CHECK: atom.global.add.f32
// CHECK: atom.global.add.f64
// CHECK: atom.global.add.u32
// CHECK: atom.global.add.u64
// CHECK: atom.relaxed.gpu.global.cas.b32
// CHECK: atom.relaxed.gpu.global.cas.b64
// CHECK: atom.relaxed.gpu.global.cas.b32
// CHECK: atom.relaxed.gpu.global.cas.b64
// CHECK: atom.relaxed.gpu.global.cas.b32
// CHECK: atom.relaxed.gpu.global.cas.b64
// CHECK: atom.global.min.s32
// CHECK: atom.global.min.s64
// CHECK: atom.global.min.u32
// CHECK: atom.global.min.u64
// CHECK: atom.relaxed.gpu.global.cas.b32
// CHECK: atom.relaxed.gpu.global.cas.b64
// CHECK: atom.global.max.s32
// CHECK: atom.global.max.s64
// CHECK: atom.global.max.u32
// CHECK: atom.global.max.u64
// CHECK: atom.global.and.b32
// CHECK: atom.global.and.b64
// CHECK: atom.global.or.b32
// CHECK: atom.global.or.b64
// CHECK: atom.global.xor.b32
// CHECK: atom.global.xor.b64

// Additions in order: no atomic operation, and a whole warp.
// CHECK-NOT: atom
// CHECK: bar.warp.sync -1;
// CHECK: match.any.sync.b64
// CHECK: vote.sync.any.pred
// CHECK: shfl.sync.idx.b32
// CHECK: add.{{(rn[.])?}}f32
// CHECK: add.{{(rn[.])?}}f64
// CHECK: bar.warp.sync -1;

// The host's build asks the emulated device for the place of a thread, and
// nothing but the function with slots is visible.
// EMULATED-NOT: define i{{.*}}
// EMULATED: define void @everything.slots(ptr
// EMULATED: declare i32 @tai_emu_block_id()

module attributes {gpu.container_module} {
  gpu.module @kernels {
    llvm.func @tai_rt_random_u32(i64, i64, i64, i32, i32) -> i32
    llvm.func @tai_rt_print(!llvm.ptr, !llvm.ptr, i32, !llvm.ptr, !llvm.ptr, !llvm.ptr)
    llvm.func @tai_rt_fail(!llvm.ptr, i32, !llvm.ptr, !llvm.ptr, i32, !llvm.ptr, !llvm.ptr, !llvm.ptr)
    llvm.func @tai_rt_failed(!llvm.ptr) -> i32
    llvm.func @tai_rt_stack_grow(!llvm.ptr, !llvm.ptr)
    llvm.func @tai_rt_stack_free(!llvm.ptr)
    llvm.func @tai_rt_activate(!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr) -> i32
    llvm.func @tai_rt_deactivate(!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr)
    llvm.func @tai_rt_append(!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr) -> i64
    llvm.func @tai_dev_thread_id() -> i32
    llvm.func @tai_dev_block_id() -> i32
    llvm.func @tai_dev_block_dim() -> i32
    llvm.func @tai_dev_grid_dim() -> i32
    llvm.func @tai_dev_block_barrier()
    llvm.func @tai_dev_grid_barrier(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_add_f32(!llvm.ptr, f32)
    llvm.func @tai_dev_reduce_add_f64(!llvm.ptr, f64)
    llvm.func @tai_dev_reduce_add_i32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_add_i64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_mul_f32(!llvm.ptr, f32)
    llvm.func @tai_dev_reduce_mul_f64(!llvm.ptr, f64)
    llvm.func @tai_dev_reduce_mul_i32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_mul_i64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_min_f32(!llvm.ptr, f32)
    llvm.func @tai_dev_reduce_min_f64(!llvm.ptr, f64)
    llvm.func @tai_dev_reduce_min_i32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_min_i64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_min_u32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_min_u64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_max_f32(!llvm.ptr, f32)
    llvm.func @tai_dev_reduce_max_f64(!llvm.ptr, f64)
    llvm.func @tai_dev_reduce_max_i32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_max_i64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_max_u32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_max_u64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_and_i32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_and_i64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_or_i32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_or_i64(!llvm.ptr, i64)
    llvm.func @tai_dev_reduce_xor_i32(!llvm.ptr, i32)
    llvm.func @tai_dev_reduce_xor_i64(!llvm.ptr, i64)

    llvm.func @tai_dev_ordered_lanes() -> i32
    llvm.func @tai_dev_ordered_meet()
    llvm.func @tai_dev_ordered_plan(!llvm.ptr) -> i64
    llvm.func @tai_dev_ordered_add_f32(i64, !llvm.ptr, f32)
    llvm.func @tai_dev_ordered_add_f64(i64, !llvm.ptr, f64)

    llvm.func @everything(%frame: !llvm.ptr, %stack: !llvm.ptr, %text: !llvm.ptr,
                          %ints: !llvm.ptr, %target: !llvm.ptr, %seed: i64,
                          %x: f32, %y: f64) attributes {gpu.kernel} {
      %none = llvm.mlir.constant(0 : i32) : i32
      %failed = llvm.call @tai_rt_failed(%frame) : (!llvm.ptr) -> i32
      %stop = llvm.icmp "ne" %failed, %none : i32
      llvm.cond_br %stop, ^done, ^work
    ^work:
      %thread = llvm.call @tai_dev_thread_id() : () -> i32
      %block = llvm.call @tai_dev_block_id() : () -> i32
      %threads = llvm.call @tai_dev_block_dim() : () -> i32
      %blocks = llvm.call @tai_dev_grid_dim() : () -> i32
      %bits = llvm.call @tai_rt_random_u32(%seed, %seed, %seed, %thread, %block) : (i64, i64, i64, i32, i32) -> i32
      llvm.call @tai_rt_stack_grow(%frame, %stack) : (!llvm.ptr, !llvm.ptr) -> ()
      llvm.call @tai_rt_stack_free(%stack) : (!llvm.ptr) -> ()
      %active = llvm.call @tai_rt_activate(%frame, %target, %bits, %seed, %text) : (!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr) -> i32
      %place = llvm.call @tai_rt_append(%frame, %target, %active, %seed, %text) : (!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr) -> i64
      llvm.call @tai_rt_deactivate(%frame, %target, %bits, %place, %text) : (!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr) -> ()
      llvm.call @tai_rt_print(%frame, %text, %bits, %ints, %ints, %ints) : (!llvm.ptr, !llvm.ptr, i32, !llvm.ptr, !llvm.ptr, !llvm.ptr) -> ()
      llvm.call @tai_rt_fail(%frame, %threads, %text, %text, %bits, %ints, %ints, %ints) : (!llvm.ptr, i32, !llvm.ptr, !llvm.ptr, i32, !llvm.ptr, !llvm.ptr, !llvm.ptr) -> ()
      llvm.call @tai_dev_block_barrier() : () -> ()
      llvm.call @tai_dev_grid_barrier(%target, %blocks) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_add_f32(%target, %x) : (!llvm.ptr, f32) -> ()
      llvm.call @tai_dev_reduce_add_f64(%target, %y) : (!llvm.ptr, f64) -> ()
      llvm.call @tai_dev_reduce_add_i32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_add_i64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_mul_f32(%target, %x) : (!llvm.ptr, f32) -> ()
      llvm.call @tai_dev_reduce_mul_f64(%target, %y) : (!llvm.ptr, f64) -> ()
      llvm.call @tai_dev_reduce_mul_i32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_mul_i64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_min_f32(%target, %x) : (!llvm.ptr, f32) -> ()
      llvm.call @tai_dev_reduce_min_f64(%target, %y) : (!llvm.ptr, f64) -> ()
      llvm.call @tai_dev_reduce_min_i32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_min_i64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_min_u32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_min_u64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_max_f32(%target, %x) : (!llvm.ptr, f32) -> ()
      llvm.call @tai_dev_reduce_max_f64(%target, %y) : (!llvm.ptr, f64) -> ()
      llvm.call @tai_dev_reduce_max_i32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_max_i64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_max_u32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_max_u64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_and_i32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_and_i64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_or_i32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_or_i64(%target, %seed) : (!llvm.ptr, i64) -> ()
      llvm.call @tai_dev_reduce_xor_i32(%target, %bits) : (!llvm.ptr, i32) -> ()
      llvm.call @tai_dev_reduce_xor_i64(%target, %seed) : (!llvm.ptr, i64) -> ()
      %lanes = llvm.call @tai_dev_ordered_lanes() : () -> i32
      llvm.call @tai_dev_ordered_meet() : () -> ()
      %plan = llvm.call @tai_dev_ordered_plan(%target) : (!llvm.ptr) -> i64
      llvm.call @tai_dev_ordered_add_f32(%plan, %target, %x) : (i64, !llvm.ptr, f32) -> ()
      llvm.call @tai_dev_ordered_add_f64(%plan, %target, %y) : (i64, !llvm.ptr, f64) -> ()
      llvm.br ^done
    ^done:
      llvm.return
    }
  }
}
