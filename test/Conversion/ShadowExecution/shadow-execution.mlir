// RUN: tai-opt %s --tai-shadow-execution | FileCheck %s
// RUN: tai-opt %s --tai-shadow-execution=f64-shadow=f128 | FileCheck %s --check-prefix=WIDE

// CHECK: llvm.mlir.global external @tai_rt_shadows() {{.*}}: !llvm.ptr

// A result that alone is off is counted in the frame. Operands, results and
// places are handed over where it may be the worst; the difference itself is
// unchanged.
// CHECK-LABEL: llvm.func @difference(
//  CHECK-SAME:     %[[FRAME:[^:]+]]: !llvm.ptr, %[[A:[^:]+]]: f32, %[[B:[^:]+]]: f32)
//       CHECK:   %[[COUNTS:.+]] = llvm.alloca %{{.+}} x i8
//       CHECK:   "llvm.intr.memset"(%[[COUNTS]],
//   CHECK-DAG:   %[[SA:.+]] = llvm.fpext %[[A]] : f32 to f64
//   CHECK-DAG:   %[[SB:.+]] = llvm.fpext %[[B]] : f32 to f64
//   CHECK-DAG:   %[[R:.+]] = llvm.fsub %[[A]], %[[B]] : f32
//   CHECK-DAG:   %[[SR:.+]] = llvm.fsub %[[SA]], %[[SB]] : f64
//       CHECK:   llvm.cond_br %{{.+}} weights([1, 100]), ^[[COUNT:bb[0-9]+]], ^[[REST:bb[0-9]+]]
//       CHECK: ^[[COUNT]]:
//       CHECK:   %[[LOST:.+]] = llvm.getelementptr %[[COUNTS]][8]
//       CHECK:   llvm.store %{{.+}}, %[[LOST]] : i64
//       CHECK:   llvm.cond_br %{{.+}} weights([1, 1000]), ^[[TELL:bb[0-9]+]], ^[[TOLD:bb[0-9]+]]
//       CHECK: ^[[TELL]]:
//       CHECK:   llvm.call @tai_rt_shadow_site(%[[FRAME]], {{.*}}%[[SR]])
//       CHECK: ^[[TOLD]]:
//       CHECK:   llvm.br ^[[REST]]
//       CHECK: ^[[REST]]:
//       CHECK:   llvm.call @tai_rt_shadow_counted(%[[FRAME]], %[[COUNTS]], %{{.+}})
//       CHECK:   llvm.return %[[R]] : f32
llvm.func @difference(%frame: !llvm.ptr, %a: f32, %b: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.fsub %a, %b : f32
  llvm.return %0 : f32
}

// A product that another operation of the block uses is not compared.
// CHECK-LABEL: llvm.func @product(
//   CHECK-NOT:   llvm.call
//       CHECK:   llvm.call @tai_rt_shadow_site
//   CHECK-NOT:   llvm.call @tai_rt_shadow_site
//       CHECK:   llvm.return
llvm.func @product(%frame: !llvm.ptr, %a: f32, %b: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.fmul %a, %b : f32
  %1 = llvm.fadd %0, %b : f32
  llvm.return %1 : f32
}

// Shadows of loaded and stored values are in the table, at twice the bits of
// the address.
// CHECK-LABEL: llvm.func @memory(
//       CHECK:   %[[ADDRESS:.+]] = llvm.mlir.addressof @tai_rt_shadows
//       CHECK:   %[[TABLE:.+]] = llvm.load %[[ADDRESS]] invariant
//       CHECK:   %[[V:.+]] = llvm.load %{{.+}} : !llvm.ptr -> f32
//       CHECK:   llvm.ptrtoint
//       CHECK:   llvm.and
//       CHECK:   llvm.shl
//       CHECK:   %[[ENTRY:.+]] = llvm.getelementptr %[[TABLE]]
//       CHECK:   %[[PAIR:.+]] = llvm.load %[[ENTRY]] {{.*}} -> vector<2xf32>
//       CHECK:   %[[COPY:.+]] = llvm.extractelement %[[PAIR]]
//       CHECK:   %[[PART:.+]] = llvm.extractelement %[[PAIR]]
//       CHECK:   %[[SAME:.+]] = llvm.fcmp "oeq" %[[COPY]], %[[V]]
//       CHECK:   llvm.select %[[SAME]], %[[PART]]
//       CHECK:   llvm.store %{{.+}} : vector<2xf32>, !llvm.ptr
//       CHECK:   llvm.return
llvm.func @memory(%frame: !llvm.ptr, %p: !llvm.ptr, %q: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.load %p : !llvm.ptr -> f32
  llvm.store %0, %q : f32, !llvm.ptr
  llvm.return
}

// f16 has no shadow in memory, and integers have none at all.
// CHECK-LABEL: llvm.func @no_entry(
//   CHECK-NOT:   llvm.ptrtoint
//       CHECK:   llvm.return
llvm.func @no_entry(%frame: !llvm.ptr, %p: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.load %p : !llvm.ptr -> f16
  llvm.store %0, %p : f16, !llvm.ptr
  %1 = llvm.load %p : !llvm.ptr -> i32
  llvm.store %1, %p : i32, !llvm.ptr
  llvm.return
}

// A block argument has a shadow that is an argument, too.
// CHECK-LABEL: llvm.func @loop(
//       CHECK:   llvm.br ^[[HEAD:bb[0-9]+]](%{{.+}}, %{{.+}}, %{{.+}} : f32, i64, f64)
//       CHECK: ^[[HEAD]](%[[X:.+]]: f32, %{{.+}}: i64, %[[S:.+]]: f64):
//       CHECK:   llvm.fadd %[[S]], %[[S]] : f64
llvm.func @loop(%frame: !llvm.ptr, %n: i64) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %one = llvm.mlir.constant(1.0 : f32) : f32
  %0 = llvm.mlir.constant(0 : i64) : i64
  %1 = llvm.mlir.constant(1 : i64) : i64
  llvm.br ^head(%one, %0 : f32, i64)
^head(%x: f32, %i: i64):
  %next = llvm.fadd %x, %x : f32
  %j = llvm.add %i, %1 : i64
  %more = llvm.icmp "slt" %j, %n : i64
  llvm.cond_br %more, ^head(%next, %j : f32, i64), ^exit
^exit:
  llvm.return %next : f32
}

// Control flow follows the floats.
// CHECK-LABEL: llvm.func @decide(
//       CHECK:   %[[C:.+]] = llvm.fcmp "olt" %{{.+}}, %{{.+}} : f32
//       CHECK:   %[[SC:.+]] = llvm.fcmp "olt" %{{.+}}, %{{.+}} : f64
//       CHECK:   llvm.icmp "ne" %[[C]], %[[SC]] : i1
//       CHECK:   llvm.call @tai_rt_shadow_flip
//       CHECK:   llvm.select %[[C]], %{{[^,]+}}, %{{[^,]+}} : i1, f32
//       CHECK:   llvm.select %[[C]], %{{[^,]+}}, %{{[^,]+}} : i1, f64
llvm.func @decide(%frame: !llvm.ptr, %a: f32, %b: f32, %p: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.fcmp "olt" %a, %b : f32
  %1 = llvm.select %0, %a, %b : i1, f32
  llvm.store %1, %p : f32, !llvm.ptr
  llvm.return
}

// CHECK-LABEL: llvm.func @update(
//   CHECK-NOT:   llvm.atomicrmw fadd
//       CHECK:   llvm.call @tai_rt_shadow_atomic
//       CHECK:   llvm.atomicrmw add
llvm.func @update(%frame: !llvm.ptr, %p: !llvm.ptr, %v: f32, %i: i32) attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.atomicrmw fadd %p, %v monotonic : !llvm.ptr, f32
  %1 = llvm.atomicrmw add %p, %i monotonic : !llvm.ptr, i32
  llvm.return
}

// Functions of libm have wider ones.
// CHECK-LABEL: llvm.func @functions(
//   CHECK-DAG:   llvm.call @tanf(
//   CHECK-DAG:   llvm.call @tan(%{{.+}}) {{.*}}: (f64) -> f64
//   CHECK-DAG:   llvm.intr.sin(%{{.+}}) : (f32) -> f32
//   CHECK-DAG:   llvm.intr.sin(%{{.+}}) : (f64) -> f64
//   CHECK-DAG:   llvm.intr.sin(%{{.+}}) : (f80) -> f80
//  WIDE-LABEL: llvm.func @functions(
//        WIDE:   llvm.intr.sin(%{{.+}}) : (f128) -> f128
llvm.func @tanf(f32) -> f32
llvm.func @functions(%frame: !llvm.ptr, %a: f32, %d: f64, %p: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.call @tanf(%a) : (f32) -> f32
  %1 = llvm.intr.sin(%0) : (f32) -> f32
  %2 = llvm.intr.sin(%d) : (f64) -> f64
  llvm.store %1, %p : f32, !llvm.ptr
  llvm.store %2, %p : f64, !llvm.ptr
  llvm.return
}

// Lanes are counted together.
// CHECK-LABEL: llvm.func @vectors(
//       CHECK:   llvm.fadd %{{.+}}, %{{.+}} : vector<2xf64>
//       CHECK:   llvm.intr.vector.reduce.or
//       CHECK:   llvm.intr.ctpop
//       CHECK:   llvm.call @tai_rt_shadow_lanes
//       CHECK:   llvm.shufflevector {{.*}} [0, 2, 1, 3] : vector<2xf32>
llvm.func @vectors(%frame: !llvm.ptr, %p: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.load %p : !llvm.ptr -> vector<2xf32>
  %1 = llvm.fadd %0, %0 : vector<2xf32>
  llvm.store %1, %p : vector<2xf32>, !llvm.ptr
  llvm.return
}

// There is no frame.
// CHECK-LABEL: llvm.func @helper(
//  CHECK-NEXT:   llvm.fsub
//  CHECK-NEXT:   llvm.return
llvm.func @helper(%a: f32, %b: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %0 = llvm.fsub %a, %b : f32
  llvm.return %0 : f32
}
