// RUN: tai-opt %s --tai-lower-struct-for | FileCheck %s --check-prefixes=CHECK,ALL
// RUN: tai-opt %s --tai-lower-struct-for="skip=all,-activity-tests" | FileCheck %s --check-prefixes=CHECK,ASKS
// RUN: tai-opt %s --tai-lower-struct-for="skip=-repeated-lookups" | FileCheck %s --check-prefixes=CHECK,EACH
// RUN: tai-opt %s --tai-lower-struct-for="skip=none" | FileCheck %s --check-prefixes=CHECK,NONE
// RUN: tai-opt %s --tai-fix-sum-order --tai-lower-struct-for | FileCheck %s --check-prefix=FIXED
// RUN: tai-opt %s --tai-to-llvm="skip=none" | FileCheck %s --check-prefix=LLVM
// RUN: not tai-opt %s --tai-lower-struct-for="skip=lists" 2>&1 | FileCheck %s --check-prefix=WRONG
// RUN: not tai-opt %s --tai-to-llvm="skip=all,-lists" 2>&1 | FileCheck %s --check-prefix=WRONG

// WRONG: there is no skip 'lists'; the skips are all, none, unchanged-lists,

// Work that a loop over a sparse field leaves out: to test whether the cell of
// the iteration is active, and to look its number up for each element again.

tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32, y: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// CHECK-LABEL: tai.kernel @visit
//       ALL:     llvm.load %{{.+}} invariant
//       ALL:     tai.store {{.*}}, @y[{{.*}}] {tai.active}
//      ASKS:     llvm.load %{{.+}} invariant
//      ASKS:     tai.store {{.*}}, @y[{{[^]]*}}] : f32
//      EACH:     llvm.load volatile
//      EACH:     tai.store {{.*}}, @y[{{.*}}] {tai.active}
//      NONE:     llvm.load volatile
//      NONE:     tai.store {{.*}}, @y[{{[^]]*}}] : f32
// FIXED-LABEL: tai.kernel @visit
//     FIXED:   } {fixed_cost = {{.*}} : f64, outer_dims = 1 : i64}
//      LLVM:   llvm.load volatile
tai.kernel @visit() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}
