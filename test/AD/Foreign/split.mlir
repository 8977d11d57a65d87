// RUN: tai-opt %s --tai-make-adjoint | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint --tai-make-adjoint | FileCheck %s

// The augmented function does what the function does, in place, and returns the
// values that it overwrites; the reverse reads them and frees them.
// CHECK-LABEL: func.func @square_in_place(
//  CHECK-SAME:     tai.split = [@square_in_place_augmented, @square_in_place_reverse]
// CHECK-LABEL: func.func @square_in_place_augmented(
//  CHECK-SAME:     %[[X:.+]]: memref<?xf64>) -> memref<?xf64>
//   CHECK-NOT:   memref.copy
//       CHECK:   %[[TAPE:.+]] = memref.alloc(%{{.+}}) : memref<?xf64>
//       CHECK:   scf.for
//       CHECK:     %[[A:.+]] = memref.load %[[X]]
//       CHECK:     memref.store %[[A]], %[[TAPE]]
//       CHECK:     %[[B:.+]] = arith.mulf %[[A]], %[[A]]
//       CHECK:     memref.store %[[B]], %[[X]]
//       CHECK:   return %[[TAPE]] : memref<?xf64>
// CHECK-LABEL: func.func @square_in_place_reverse(
//  CHECK-SAME:     %[[X:.+]]: memref<?xf64>, %[[G:.+]]: memref<?xf64>, %[[TAPE:.+]]: memref<?xf64>)
//       CHECK:   scf.for
//       CHECK:     memref.load %[[TAPE]]
//   CHECK-NOT:     memref.load %[[X]]
//       CHECK:   memref.dealloc %[[TAPE]]
//       CHECK:   return
// CHECK-NOT: @square_in_place_grad
func.func @square_in_place(%x: memref<?xf64>) attributes {tai.differentiate, tai.split} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = memref.dim %x, %c0 : memref<?xf64>
  scf.for %i = %c0 to %n step %c1 {
    %a = memref.load %x[%i] : memref<?xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %x[%i] : memref<?xf64>
  }
  return
}

// Values that memory keeps, and arguments, are no part of the tape. Results
// come first.
// CHECK-LABEL: func.func @product_augmented(
//  CHECK-SAME:     %[[A:.+]]: f32, %[[X:.+]]: memref<4xf32>) -> f32
//       CHECK:   %[[V:.+]] = arith.mulf
//       CHECK:   return %[[V]] : f32
// CHECK-LABEL: func.func @product_reverse(
//  CHECK-SAME:     %{{.+}}: f32, %[[X:.+]]: memref<4xf32>, %{{.+}}: memref<f32>, %{{.+}}: memref<4xf32>, %{{.+}}: memref<f32>)
//       CHECK:   memref.load %[[X]]
//       CHECK:   return
func.func @product(%a: f32, %x: memref<4xf32>) -> f32
    attributes {tai.differentiate, tai.split, tai.gradients = array<i64: 0, 1, 2>} {
  %c1 = arith.constant 1 : index
  %0 = memref.load %x[%c1] : memref<4xf32>
  %1 = arith.mulf %0, %a : f32
  return %1 : f32
}

// The C interface and the visibility are those of the function.
// CHECK: func.func private @hidden_augmented({{.*}}llvm.emit_c_interface
// CHECK: func.func private @hidden_reverse({{.*}}llvm.emit_c_interface
func.func private @hidden(%x: memref<4xf32>)
    attributes {tai.differentiate, tai.split, llvm.emit_c_interface} {
  %c1 = arith.constant 1 : index
  %0 = memref.load %x[%c1] : memref<4xf32>
  %1 = math.sin %0 : f32
  memref.store %1, %x[%c1] : memref<4xf32>
  return
}
