// RUN: tai-opt %s --tai-convert-to-llvm | FileCheck %s
// RUN: tai-opt %s --tai-convert-to-llvm=contract=false | FileCheck %s --check-prefix=PLAIN
// RUN: tai-opt %s --tai-convert-to-llvm=fast-math=true | FileCheck %s --check-prefix=FAST

// Float options hold for arithmetic, and not for what decides.
// CHECK-LABEL: llvm.func @floats
//       CHECK:   llvm.fadd %{{.+}} {fastmathFlags = #llvm.fastmath<contract>}
//       CHECK:   llvm.fcmp "olt" %{{[^,]+}}, %{{[^,]+}} : f32
//       CHECK:   llvm.fmul {{.+}} {fastmathFlags = #llvm.fastmath<contract, reassoc>}
// PLAIN-LABEL: llvm.func @floats
//       PLAIN:   llvm.fadd %{{[^,]+}}, %{{[^,]+}} : f32
//       PLAIN:   llvm.fmul {{.+}} {fastmathFlags = #llvm.fastmath<reassoc>}
//  FAST-LABEL: llvm.func @floats
//        FAST:   llvm.fadd %{{.+}} {fastmathFlags = #llvm.fastmath<nsz, arcp, contract, afn, reassoc>}
llvm.func @floats(%a: f32, %b: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %0 = arith.addf %a, %b : f32
  %1 = arith.cmpf olt, %0, %b : f32
  %2 = arith.select %1, %0, %b : f32
  %3 = arith.mulf %2, %2 fastmath<reassoc> : f32
  llvm.return %3 : f32
}

// Intrinsics where LLVM has them, libm where not.
// CHECK-LABEL: llvm.func @functions
//       CHECK:   llvm.intr.sin
//       CHECK:   llvm.intr.sqrt
//       CHECK:   llvm.call @erff
//       CHECK:   llvm.call @cbrtf
//       CHECK:   llvm.call @log1pf
// PLAIN-LABEL: llvm.func @functions
//       PLAIN:   llvm.intr.exp2
//       PLAIN:   llvm.intr.sin
//       PLAIN:   llvm.intr.sqrt
//  FAST-LABEL: llvm.func @functions
//        FAST:   llvm.intr.sqrt
llvm.func @functions(%x: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  %power = math.exp2 %x : f32
  %0 = math.sin %power : f32
  %1 = math.sqrt %0 : f32
  %2 = math.erf %1 : f32
  %3 = math.cbrt %2 : f32
  %4 = math.log1p %3 : f32
  llvm.return %4 : f32
}

// Structured control flow becomes branches, and facts about a loop go to its
// latch.
// CHECK-LABEL: llvm.func @loop
//   CHECK-NOT:   scf.
//       CHECK:   llvm.br ^bb1(%{{.+}} : i64)
//       CHECK:   llvm.cond_br
//       CHECK:   llvm.br ^bb1(%{{.+}} : i64) {loop_annotation = #{{.+}}}
#group = #llvm.access_group<id = distinct[0]<>>
#annotation = #llvm.loop_annotation<parallelAccesses = #group>
llvm.func @loop(%p: !llvm.ptr, %n: i64, %x: f32) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %m = arith.index_cast %n : i64 to index
  scf.for %i = %c0 to %m step %c1 {
    llvm.store %x, %p {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #annotation}
  llvm.return
}

// Division that rounds down.
// CHECK-LABEL: llvm.func @floor
//       CHECK:   llvm.sdiv
//       CHECK:   llvm.select
llvm.func @floor(%a: i32, %b: i32) -> i32 attributes {passthrough = ["tai.lowered"]} {
  %0 = arith.floordivsi %a, %b : i32
  llvm.return %0 : i32
}
